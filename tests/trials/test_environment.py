"""What the environment of a process says is no part of a trial: the order of hashes, the language, the place."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

from played_trials import config

PLAY = """
from pathlib import Path
from imolo.config.loading import load_config
from imolo.contracts.trial import Trial, TrialKind
from imolo.trials.trainer import MotionPlayer
from imolo.trials.trial import run_trial
chosen = load_config(Path("config.yaml"))
run_trial(chosen, Trial(TrialKind.TRAINING, 3, 7), MotionPlayer(chosen.motion, (0.5, 0.25)), Path("log"), 0.3)
print(chosen.digest())
"""
ENVIRONMENTS = (
    {"PYTHONHASHSEED": "0", "LC_ALL": "C"},
    {"PYTHONHASHSEED": "4242", "LC_ALL": "tr_TR.UTF-8", "TZ": "Asia/Tokyo", "PYTHONUTF8": "0"},
)


def test_same_seed_gives_the_same_log_under_other_hash_seeds_and_locales(tmp_path: Path) -> None:
    text = json.dumps(config("mujoco").model_dump(mode="json"))  # JSON is YAML
    found = set()
    for number, environment in enumerate(ENVIRONMENTS):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "config.yaml").write_text(text, encoding="utf-8")
        ran = subprocess.run(
            [sys.executable, "-c", PLAY],
            cwd=folder,
            env={**os.environ, **environment},
            capture_output=True,
            text=True,
            check=False,
        )
        assert ran.returncode == 0, ran.stderr
        found.add((ran.stdout, hashlib.sha256((folder / "log").read_bytes()).hexdigest()))
    assert len(found) == 1
