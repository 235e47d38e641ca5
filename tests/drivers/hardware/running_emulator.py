"""The emulator in a thread beside a test, on free ports."""

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

import played_trials as trials

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import make_config
from imolo_drivers.board.config import BoardConfig
from imolo_drivers.emulator import EmulatedRobot
from imolo_drivers.natnet.calibration import Calibration
from imolo_drivers.natnet.config import NatNetServerConfig

PATIENCE = 20.0  # [s]
PATIENT = {
    "patience": PATIENCE,
    "camera_patience": 5.0,
    "board_silence": 5.0,
    "clock_jump": 1.0,
}  # on a machine that is busy with other tests


class RunningEmulator:
    def __init__(self, engine: str, calibration: Calibration | None) -> None:
        self.said: list[str] = []
        config = trials.config(engine)
        board = BoardConfig(watchdog=1.0, silence=5.0)
        cameras = NatNetServerConfig(command_port=0)
        self.robot = EmulatedRobot(config, board, ("127.0.0.1", 0), cameras, True, self.said.append, calibration)
        self.failure: BaseException | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def config(self, **options: Any) -> ExperimentConfig:
        host, port = self.robot.board.address
        cameras = {"command_port": self.robot.motive.port, "silence_limit": 5.0}
        backend = {"name": "hardware", "board": f"{host}:{port}", "cameras": cameras, **PATIENT, **options}
        return make_config({"backend": backend})

    def stop(self) -> None:
        self._stop.set()
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive(), "the emulator hangs"
        assert self.failure is None, f"the emulator crashed: {self.failure!r}"

    def _run(self) -> None:
        try:
            self.robot.run(self._stop.is_set)
        except BaseException as error:  # noqa: BLE001
            self.failure = error


@contextlib.contextmanager
def emulator(engine: str = "mujoco", calibration: Calibration | None = None) -> Iterator[RunningEmulator]:
    running = RunningEmulator(engine, calibration)
    try:
        yield running
    finally:
        running.stop()
