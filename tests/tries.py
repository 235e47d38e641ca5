"""How often a test tries things that chance chooses: IMOLO_TRIES=2000 python -m pytest ... tries them 2000 times."""

import os


def tries(usual: int) -> int:
    """Return the number of tries: `usual`, or what the environment variable IMOLO_TRIES says."""
    return int(os.environ.get("IMOLO_TRIES", usual))
