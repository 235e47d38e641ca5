"""The motion of the paper in every engine: a jump and a swing that k and t_w lead to different places."""

from functools import cache
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np
import pytest
from liberobot import CONFIG, TRAINING_MOTIONS
from played_trials import COARSE, hand_in_truth, play_motion, quiet
from requirements import BACKEND_PARAMS, needs

from imolo.identification.study_file import load_study
from imolo.messaging import channels
from imolo.messaging.log import Log
from imolo.method.motion import Theta
from imolo.trials.recordings import last_plan

SWING = CONFIG.training.comparison_time  # [s] since t_w, in the middle of the samples of Sec. VII-B
FINE = 1e-4  # [s] Sec. VI
SHOULDERS = slice(6, 8)


@cache
def motion(
    backend: str,
    theta: Theta,
    sole: Literal["semicircular", "flat"] = "semicircular",
    timestep: float = COARSE,
    contact_friction: float = CONFIG.simulation.contact.friction,
    **options: str,
) -> Log:
    chosen = quiet(backend, timestep, options, {"sole": sole}, contact={"friction": contact_friction})
    with TemporaryDirectory() as folder:
        return play_motion(chosen, Path(folder) / "log", theta, SWING + 0.03)


def hand(log: Log) -> np.ndarray:
    """Return where the right hand truly was in the middle of the swing [m], shape (3,)."""
    plan = last_plan(log)
    assert plan is not None
    return hand_in_truth(log, plan.plan_onset_utime + round((plan.theta[1] + SWING) * 1e6))


@pytest.mark.parametrize("backend", BACKEND_PARAMS)
@pytest.mark.parametrize("theta", [(0.0, 0.31), (1.0, 0.41), (-1.0, 0.21)])
def test_robot_jumps_and_swings(backend: str, theta: Theta) -> None:
    truth = motion(backend, theta).messages[channels.TRUTH_ROBOT]
    height = np.array([message.base_position[2] for message in truth])
    shoulder = np.degrees([message.joint_angle[SHOULDERS] for message in truth])
    # Legs of 0.6 m that only stand up lift the trunk by less than 0.45 m from the crouch; the rest is a jump.
    assert height.max() - height[0] > 0.5
    # Arms hang at 0°, and have 150° to go; 60° brings the hand in front of the body.
    assert (shoulder.max(axis=0) > 60.0).all()
    assert (shoulder[0] < 1.0).all()


@pytest.mark.parametrize("backend", BACKEND_PARAMS)
def test_k_leads_the_hand_sideways(backend: str) -> None:
    right, middle, left = (hand(motion(backend, (k, 0.31)))[1] for k in (-1.0, 0.0, 1.0))
    # The ball is 90 mm wide: from end to end k reaches over more than one ball.
    assert right < middle < left
    assert left - right > 0.09


@pytest.mark.parametrize("backend", BACKEND_PARAMS)
def test_mirrored_k_mirrors_the_trunk(backend: str) -> None:
    """The robot is symmetric, so +k and -k lean it equally far to either side."""
    one, other = (motion(backend, (k, 0.31)).messages[channels.TRUTH_ROBOT] for k in (-0.5, 0.5))
    lean = np.array([message.base_position[1] for message in one])
    mirrored = -np.array([message.base_position[1] for message in other])
    # What an engine adds by the order in which it solves its contacts is small beside the lean.
    assert abs(lean - mirrored).max() < 0.1 * abs(lean).max()


@pytest.mark.parametrize("backend", BACKEND_PARAMS)
def test_t_w_leads_the_hand_forward(backend: str) -> None:
    early, middle, late = (hand(motion(backend, (0.0, t_w)))[0] for t_w in (0.21, 0.31, 0.41))
    assert early < middle < late


@pytest.mark.parametrize("backend", BACKEND_PARAMS)
def test_motion_without_k_stays_in_the_sagittal_plane(backend: str) -> None:
    truth = motion(backend, (0.0, 0.31)).messages[channels.TRUTH_ROBOT]
    sideways = abs(np.array([message.base_position[1] for message in truth])).max()
    leaning = abs(np.array([m.base_position[1] for m in motion(backend, (1.0, 0.31)).messages["TRUTH_ROBOT"]]))
    assert sideways < 0.02 * leaning.max()


# At the friction of the experiments a flat foot slips a little when it leaves the box, which turns the robot: by 0, 9
# and 2 % of the round soles' reach in MuJoCo, PyBullet and DART, by 47 % in ODE and 41 % in DART with a pyramid. The
# claim is about the shape, so it is tested where nothing slips.
NO_SLIP = 3.0


@pytest.mark.parametrize("backend", BACKEND_PARAMS)
def test_flat_soles_hardly_move_the_hand_sideways(backend: str) -> None:
    """Sec. V-A: with flat soles the motion stays in the sagittal plane, whatever k."""

    def reach(sole: Literal["semicircular", "flat"]) -> float:
        right, left = (hand(motion(backend, (k, 0.31), sole, FINE, NO_SLIP))[1] for k in (-1.0, 1.0))
        return float(left - right)

    assert abs(reach("flat")) < 0.1 * reach("semicircular")


# Engines are held to each other on the robot as it was first assumed; the hands of the fitted one are farther apart:
# docs/why-engines-differ.md.
# Measured: mujoco - pybullet 5.6 ± 4.4, mujoco - dart 3.6 ± 2.7, pybullet - dart 4.8 ± 4.0 mm. The bound is the one the
# project has set itself.
AGREEMENT = 12.0  # [mm]
ASSUMED = load_study(Path(__file__).parents[2] / "configs" / "studies" / "liberobot_paper.yaml").config


@cache
def assumed_hand(backend: str, theta: Theta, **options: str) -> np.ndarray:
    asked = {key: ASSUMED["simulation"][key] for key in ("actuators", "contact")}
    chosen = quiet(backend, FINE, options, ASSUMED["robot"], **asked)
    with TemporaryDirectory() as folder:
        return hand(play_motion(chosen, Path(folder) / "log", theta, SWING + 0.03))


def disagreement(one: str, other: str, **options: str) -> float:
    """Return how far apart the hands are, mean over Table III [mm]; the options are those of the second backend."""
    distances = [
        np.linalg.norm(assumed_hand(one, theta) - assumed_hand(other, theta, **options)) for theta in TRAINING_MOTIONS
    ]
    return 1e3 * float(np.mean(distances))


@pytest.mark.slow
@pytest.mark.parametrize(("one", "other"), list(combinations(("mujoco", "pybullet", "dart"), 2)))
def test_hands_of_two_engines_with_a_cone_agree_over_table_iii(one: str, other: str) -> None:
    assert disagreement(one, other) < AGREEMENT


@pytest.mark.slow
@pytest.mark.parametrize("other", [pytest.param(name, marks=needs(name)) for name in ("drake", "sapien")])
def test_hands_of_drake_and_sapien_agree_with_mujocos(other: str) -> None:
    """Measured: mujoco - drake 7.2 ± 3.3, mujoco - sapien 8.4 ± 5.3 mm."""
    assert disagreement("mujoco", other) < AGREEMENT


@pytest.mark.slow
@pytest.mark.parametrize("ode", [pytest.param("ode", marks=needs("ode"))])
def test_ode_agrees_with_the_direct_solver_of_dart(ode: str) -> None:
    """ODE solves its contacts as DART does with `friction: pyramid`; measured 3 mm, and 15 to 17 mm from the others."""
    assert disagreement(ode, "dart", friction="pyramid") < AGREEMENT
    for other in ("mujoco", "pybullet", "dart"):
        assert disagreement(ode, other) > AGREEMENT
