"""The Open Dynamics Engine, or the way to get it; alone in a module so that it is quickly seen whether it is there."""

import shlex
import sys
from pathlib import Path

try:
    import ode

    ode.HingeJoint  # noqa: B018 - PyPI has another package of this name
except (ImportError, AttributeError) as error:
    get = shlex.join(["bash", str(Path(__file__).with_name("get_ode")), sys.executable])
    raise ImportError(
        f"{error}; PyPI has no wheel of the Open Dynamics Engine, Debian has one for its own version of Python: {get}"
    ) from error

__all__ = ["ode"]
