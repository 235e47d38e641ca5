"""Sensors that block, fail or talk nonsense hold nothing up, and are told."""

import threading
from collections.abc import Callable, Sequence

import pytest
from board_by_hand import START, armed_controller, board_by_hand
from board_link import PATIENCE, VENTED, eventually

from imolo.errors import BackendError
from imolo_drivers.board.sensor_reader import SensorReader

LIMIT = 100_000  # [µs]


def test_board_vents_in_time_while_the_sensors_block() -> None:
    """The reading has not come back when the board has vented."""
    release = threading.Event()
    with board_by_hand() as board:
        armed_controller(board)
        read = board.valves.read
        board.sensors_block, board.server._sensors._read = True, lambda: (release.wait(PATIENCE), read())[1]
        board.until(lambda: board.server._sensors._is_busy)
        heard = board.server.board._heard
        board.until(lambda: board.state == "LATCHED")
        assert board.now <= heard + LIMIT
        assert board.valves.pressure == VENTED
        assert not release.is_set()
        release.set()


def test_sensors_that_do_not_answer_vent_though_all_else_is_well() -> None:
    release = threading.Event()
    with board_by_hand() as board:
        controller = armed_controller(board)
        board.sensors_block, board.server._sensors._read = True, lambda: (release.wait(PATIENCE), VENTED)[1]
        while board.state == "ARMED":
            controller.ask()
            board.turn(5000)
            assert board.now < START + 10 * LIMIT
        assert "the sensors have not answered for" in board.server.board.cause
        release.set()


def read_nothing() -> Sequence[float]:
    raise BackendError("the ADC does not answer")


def read_nonsense() -> Sequence[float]:
    raise ZeroDivisionError("by zero")


@pytest.mark.parametrize(
    ("read", "cause"),
    [
        (read_nothing, "the ADC does not answer"),
        (read_nonsense, "the sensors cannot be read: ZeroDivisionError"),
        (lambda: (1.0, 2.0), "the sensors told 2 values"),
    ],
)
def test_sensors_that_fail_vent_and_are_told(read: Callable[[], Sequence[float]], cause: str) -> None:
    with board_by_hand(watchdog=1.0, silence=60.0) as board:
        armed_controller(board)
        board.server._sensors._read = read
        board.until(lambda: board.state == "LATCHED")
        assert cause in board.server.board.cause


def test_one_reading_is_under_way_at_a_time() -> None:
    release, begun = threading.Event(), []

    def read() -> Sequence[float]:
        begun.append(1)
        release.wait(PATIENCE)
        return VENTED

    reader = SensorReader(read, LIMIT)
    for utime in range(START, START + LIMIT, 1000):
        reader.ask(utime)
    assert eventually(lambda: len(begun) == 1)
    assert reader.newest(START + LIMIT).fault == ""
    assert "for 100.1 ms" in reader.newest(START + LIMIT + 100).fault
    release.set()
    assert eventually(lambda: reader.newest(START + 10 * LIMIT).measured == VENTED)
    assert reader.newest(0).utime == START
    reader.close()
    assert len(begun) == 1
