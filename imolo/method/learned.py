"""What a table file holds for a planner: the table, and the model of the ball it was learned with."""

from functools import lru_cache
from pathlib import Path

from imolo.ball.fit import restore_ball_model
from imolo.ball.model import BallModel
from imolo.method.motion import MotionTemplate
from imolo.method.table import LookupTable


def load_learned(path: Path, robot: str, motion: type[MotionTemplate]) -> tuple[LookupTable, BallModel]:
    """Return the table of a file and the ball model it was learned with.

    Raises:
        TableFileError: The file cannot be read, or is for another robot.
    """
    modified = path.stat().st_mtime_ns if path.is_file() else 0
    return _load(path, modified, robot, motion)


@lru_cache(maxsize=2)  # of some 140 MB each; loky ends a process that grows by more than 300 MB
def _load(path: Path, _modified: int, robot: str, motion: type[MotionTemplate]) -> tuple[LookupTable, BallModel]:
    table = LookupTable.load(path, robot, motion)
    return table, restore_ball_model(table.origin["ball_model"])
