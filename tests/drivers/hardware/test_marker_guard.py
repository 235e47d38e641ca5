"""Who is who among the markers, frame after frame and after gaps of any length."""

from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scripted_robot import BODY

from imolo_drivers.marker_guard import MarkerGuard, MarkerGuardConfig
from imolo_msgs import marker_t, mocap_frame_t

RIGHT_HAND, LEFT_HAND = 6, 7
FRAME = 8_333  # [µs]
PATIENCE = 250_000  # [µs] a longer gap voids the trial


def frame(utime: int, places: Mapping[int, object]) -> mocap_frame_t:
    message = mocap_frame_t()
    message.utime, message.num_markers = utime, len(places)
    for label, place in places.items():
        marker = marker_t()
        marker.marker_id, marker.marker_position = label, np.asarray(place).tolist()
        message.markers.append(marker)
    return message


def places(message: mocap_frame_t) -> dict[int, tuple[float, ...]]:
    return {marker.marker_id: tuple(marker.marker_position) for marker in message.markers}


def known_robot() -> MarkerGuard:
    guard = MarkerGuard(MarkerGuardConfig())
    guard.repair(frame(0, BODY))
    return guard


@pytest.mark.parametrize("gap", [FRAME, 35_000, 57_000, 100_000, PATIENCE])
def test_hands_that_swap_their_names_in_a_gap_get_them_back(gap: int) -> None:
    guard = known_robot()
    seen = frame(gap, {**BODY, RIGHT_HAND: BODY[LEFT_HAND], LEFT_HAND: BODY[RIGHT_HAND]})
    guard.repair(seen)
    assert places(seen) == {label: tuple(place) for label, place in BODY.items()}
    assert (guard.renamed, guard.removed) == (2, 0)


@pytest.mark.parametrize("gap", [FRAME, 35_000, PATIENCE])
def test_three_names_that_go_round_in_a_gap_come_back(gap: int) -> None:
    guard = known_robot()
    round_robin = {RIGHT_HAND: BODY[LEFT_HAND], LEFT_HAND: BODY[0], 0: BODY[RIGHT_HAND]}
    seen = frame(gap, {**BODY, **round_robin})
    guard.repair(seen)
    assert places(seen) == {label: tuple(place) for label, place in BODY.items()}


@settings(deadline=None, max_examples=50)
@given(
    gap=st.integers(FRAME, PATIENCE),
    share=st.floats(0.0, 1.0),
    direction=st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda one: np.linalg.norm(one) > 0.1),
)
def test_a_robot_that_moves_as_a_whole_keeps_its_names(gap: int, share: float, direction: tuple[float, ...]) -> None:
    limits = MarkerGuardConfig()
    step = np.array(direction) / np.linalg.norm(direction) * share * limits.speed * gap * 1e-6
    guard = known_robot()
    seen = frame(gap, {label: place + step for label, place in BODY.items()})
    guard.repair(seen)
    assert places(seen) == {label: tuple(place + step) for label, place in BODY.items()}
    assert (guard.renamed, guard.removed) == (0, 0)


def test_a_jump_is_believed_up_to_slack_and_speed_and_left_out_beyond() -> None:
    limits = MarkerGuardConfig()
    reach = limits.slack + limits.speed * FRAME * 1e-6
    for far, kept in ((reach - 1e-3, True), (reach + 1e-3, False)):
        guard = known_robot()
        seen = frame(FRAME, {**BODY, RIGHT_HAND: BODY[RIGHT_HAND] + [far, 0.0, 0.0]})
        guard.repair(seen)
        assert (RIGHT_HAND in places(seen)) is kept
        assert seen.num_markers == len(seen.markers) == len(BODY) - (not kept)
        assert guard.removed == (not kept)


def test_a_marker_that_was_left_out_is_measured_from_where_it_was_last_believed() -> None:
    guard = known_robot()
    guard.repair(frame(FRAME, {**BODY, RIGHT_HAND: BODY[RIGHT_HAND] + [1.5, 0.0, 0.0]}))
    back = frame(2 * FRAME, BODY)
    guard.repair(back)
    assert places(back) == {label: tuple(place) for label, place in BODY.items()}


def test_unlabelled_markers_are_let_through() -> None:
    guard = known_robot()
    for utime, place in ((FRAME, (0.0, 0.0, 0.0)), (2 * FRAME, (9.0, 9.0, 9.0))):
        ball = frame(utime, {marker_t.UNLABELLED: place})
        guard.repair(ball)
        assert places(ball) == {marker_t.UNLABELLED: place}
