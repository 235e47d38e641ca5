"""The motion of the paper in every engine: a jump and a swing that k and t_w lead to different places."""

from functools import cache
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np
import pytest
from requirements import BACKEND_NAMES, needs
from trials import BACKENDS, COARSE, hand_in_truth, play_motion, quiet

from imolo import channels
from imolo.config.simulation import ContactConfig
from imolo.experiment.recordings import last_plan
from imolo.log import Log
from imolo.method.motion import TRAINING_MOTIONS, Theta

SWING = 0.17  # [s] since t_w, in the middle of the samples of Sec. VII-B
FINE = 1e-4  # [s] Sec. VI
SHOULDERS = slice(6, 8)


@cache
def motion(
    backend: str,
    theta: Theta,
    sole: Literal["semicircular", "flat"] = "semicircular",
    timestep: float = COARSE,
    friction: float = ContactConfig().friction,
) -> Log:
    chosen = quiet(backend, timestep, sole=sole, contact={"friction": friction})
    with TemporaryDirectory() as folder:
        return play_motion(chosen, Path(folder) / "log", theta, SWING + 0.03)


def hand(log: Log) -> np.ndarray:
    """Return where the right hand truly was in the middle of the swing [m], shape (3,)."""
    plan = last_plan(log)
    assert plan is not None
    return hand_in_truth(log, plan.plan_onset_utime + round((plan.theta[1] + SWING) * 1e6))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("theta", [Theta(0.0, 0.31), Theta(1.0, 0.41), Theta(-1.0, 0.21)])
def test_robot_jumps_and_swings(backend: str, theta: Theta) -> None:
    truth = motion(backend, theta).messages[channels.TRUTH_ROBOT]
    height = np.array([message.trunk_position[2] for message in truth])
    shoulder = np.degrees([message.joint_angle[SHOULDERS] for message in truth])
    # Legs of 0.6 m that only stand up lift the trunk by less than 0.45 m from the crouch; the rest is a jump.
    assert height.max() - height[0] > 0.5
    # Arms hang at 0°, and have 150° to go; 60° brings the hand in front of the body.
    assert (shoulder.max(axis=0) > 60.0).all()
    assert (shoulder[0] < 1.0).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_k_leads_the_hand_sideways(backend: str) -> None:
    right, middle, left = (hand(motion(backend, Theta(k, 0.31)))[1] for k in (-1.0, 0.0, 1.0))
    # The ball is 90 mm wide: from end to end k reaches over more than one ball.
    assert right < middle < left
    assert left - right > 0.09


@pytest.mark.parametrize("backend", BACKENDS)
def test_mirrored_k_mirrors_the_trunk(backend: str) -> None:
    """The robot is symmetric, so +k and -k lean it equally far to either side."""
    one, other = (motion(backend, Theta(k, 0.31)).messages[channels.TRUTH_ROBOT] for k in (-0.5, 0.5))
    lean = np.array([message.trunk_position[1] for message in one])
    mirrored = -np.array([message.trunk_position[1] for message in other])
    # What an engine adds by the order in which it solves its contacts is small beside the lean.
    assert abs(lean - mirrored).max() < 0.1 * abs(lean).max()


@pytest.mark.parametrize("backend", BACKENDS)
def test_t_w_leads_the_hand_forward_and_up(backend: str) -> None:
    early, middle, late = (hand(motion(backend, Theta(0.0, t_w))) for t_w in (0.21, 0.31, 0.41))
    for axis in (0, 2):
        assert early[axis] < middle[axis] < late[axis]


@pytest.mark.parametrize("backend", BACKENDS)
def test_motion_without_k_stays_in_the_sagittal_plane(backend: str) -> None:
    truth = motion(backend, Theta(0.0, 0.31)).messages[channels.TRUTH_ROBOT]
    sideways = abs(np.array([message.trunk_position[1] for message in truth])).max()
    leaning = abs(np.array([m.trunk_position[1] for m in motion(backend, Theta(1.0, 0.31)).messages["TRUTH_ROBOT"]]))
    assert sideways < 0.02 * leaning.max()


# At the friction of the experiments a flat foot slips a little when it leaves the box, which turns the robot: by 6 and
# 5 % of the round soles' reach in MuJoCo and PyBullet, by 41 % in DART and 47 % in ODE, with or without a pyramid. The
# claim is about the shape, so it is tested where nothing slips.
NO_SLIP = 3.0


@pytest.mark.parametrize("backend", BACKENDS)
def test_flat_soles_hardly_move_the_hand_sideways(backend: str) -> None:
    """Sec. V-A: with flat soles the motion stays in the sagittal plane, whatever k."""

    def reach(sole: Literal["semicircular", "flat"]) -> float:
        right, left = (hand(motion(backend, Theta(k, 0.31), sole, FINE, NO_SLIP))[1] for k in (-1.0, 1.0))
        return float(left - right)

    assert abs(reach("flat")) < 0.1 * reach("semicircular")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("one", "other"),
    [pytest.param(*pair, marks=needs(*pair)) for pair in combinations(BACKEND_NAMES, 2)],
)
def test_hands_of_two_engines_agree_over_table_iii(one: str, other: str) -> None:
    distance = [
        1e3 * np.linalg.norm(hand(motion(one, theta, timestep=FINE)) - hand(motion(other, theta, timestep=FINE)))
        for theta in TRAINING_MOTIONS
    ]
    # Measured: mujoco - pybullet 11.3 ± 6.3, mujoco - dart 21.7 ± 9.9, pybullet - dart 14.5 ± 8.6, mujoco - ode
    # 20.1 ± 9.8, pybullet - ode 12.4 ± 6.4, dart - ode 3.9 ± 3.4 mm. The bound is the one the project has set itself.
    assert np.mean(distance) < 25.0
