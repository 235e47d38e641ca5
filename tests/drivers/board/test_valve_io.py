"""The converters of the board: libiio itself, on devices that look like those of the Linux kernel."""

import ctypes
import functools
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from requirements import needs
from typer.testing import CliRunner

from imolo.command_line.main import app
from imolo.errors import BackendError, MissingToolError
from imolo_drivers.board.valve_io import IIO_DEVICES, ConverterConfig, IioConfig, IioValves, SimulatedValves, _code

NUM_VALVES = 8  # of the default robot
FULL_SCALE = 1.0e6  # [Pa]
CLONE_NEWNS = 0x20000
DAC = ConverterConfig(device="some-dac", full_scale=FULL_SCALE, channels=tuple(reversed(range(NUM_VALVES))))
ADC = ConverterConfig(device="some-adc", full_scale=FULL_SCALE, zero_code=400, highest_code=4000)
CONVERTERS = IioConfig(dac=DAC, adc=ADC)


def make_devices() -> None:
    """Show this thread, and nobody else, two converters under /sys."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(CLONE_NEWNS) != 0:
        raise OSError(ctypes.get_errno(), "unshare failed")
    subprocess.run(["mount", "--make-rprivate", "/"], check=True)
    subprocess.run(["mount", "-t", "tmpfs", "tmpfs", "/sys/bus"], check=True)
    for number, name, file in ((0, "some-dac", "out_voltage{}_raw"), (1, "some-adc", "in_voltage{}_raw")):
        folder = IIO_DEVICES / f"iio:device{number}"
        folder.mkdir(parents=True)
        (folder / "name").write_text(f"{name}\n")
        for channel in range(NUM_VALVES):
            (folder / file.format(channel)).write_text("0\n")


def with_devices(test: Callable[..., None]) -> Callable[..., None]:
    """Run a test in a thread that sees the converters."""

    @functools.wraps(test)
    def run(*arguments: object, **named: object) -> None:
        seen_outside = IIO_DEVICES.exists()
        with ThreadPoolExecutor(1) as thread:
            thread.submit(make_devices).result()
            thread.submit(test, *arguments, **named).result()
        assert IIO_DEVICES.exists() == seen_outside

    for mark in needs("iio"):
        run = mark(run)
    return run


def output(channel: int) -> int:
    # The kernel takes each write as a whole; in a file the rest of a longer one stays.
    return int((IIO_DEVICES / f"iio:device0/out_voltage{channel}_raw").read_text().split("\0")[0])


def measure(channel: int, text: str) -> None:
    (IIO_DEVICES / f"iio:device1/in_voltage{channel}_raw").write_text(text)


@with_devices
def test_targets_become_the_nearest_codes_on_the_wired_channels() -> None:
    valves = IioValves(CONVERTERS)
    valves.write([FULL_SCALE, *[0.5 * FULL_SCALE] * 6, 1.0e4])
    assert [output(channel) for channel in (7, 3, 0)] == [4095, 2048, round(4095 * 0.01)]
    valves.close()


@with_devices
def test_codes_of_the_sensors_become_pressures() -> None:
    measure(2, "2200\n")
    valves = IioValves(CONVERTERS)
    assert valves.read()[2] == pytest.approx(0.5 * FULL_SCALE)
    assert valves.read()[0] == pytest.approx(-FULL_SCALE / 9.0)
    measure(2, "4000\n")
    assert valves.read()[2] == pytest.approx(FULL_SCALE)
    valves.close()


@with_devices
def test_converter_that_has_no_such_channel_is_told() -> None:
    with pytest.raises(BackendError, match="some-dac has no output voltage8"):
        IioValves(CONVERTERS.model_copy(update={"dac": DAC.model_copy(update={"channels": tuple(range(1, 9))})}))
    with pytest.raises(BackendError, match="some-dac has no input voltage0"):
        IioValves(CONVERTERS.model_copy(update={"adc": DAC.model_copy(update={"channels": tuple(range(8))})}))


@with_devices
def test_missing_converter_is_told_with_those_that_are_there() -> None:
    missing = CONVERTERS.model_copy(update={"dac": DAC.model_copy(update={"device": "some-dag"})})
    with pytest.raises(BackendError, match=r"'some-dag'; did you mean 'some-dac'\?; there are: some-dac, some-adc"):
        IioValves(missing)


@with_devices
def test_machine_without_converters_is_told() -> None:
    for device in list(IIO_DEVICES.iterdir()):
        device.rename(IIO_DEVICES / f"no {device.name}")
    with pytest.raises(BackendError, match=r"there are no IIO devices under /sys/bus/iio/devices; are the drivers"):
        IioValves(CONVERTERS)


@with_devices
def test_sensor_that_says_no_number_is_told() -> None:
    measure(4, "busy\n")
    valves = IioValves(CONVERTERS)
    with pytest.raises(BackendError, match="pressure of valve 5"):
        valves.read()
    valves.close()


@with_devices
def test_converters_that_are_taken_away_are_told_and_go_on_when_they_are_back() -> None:
    valves = IioValves(CONVERTERS)
    valves.write([FULL_SCALE] * NUM_VALVES)
    away = IIO_DEVICES.rename(IIO_DEVICES.with_name("away"))
    with pytest.raises(BackendError, match=r"DAC does not take code 0 for valve 1: .*No such file"):
        valves.write([0.0] * NUM_VALVES)
    with pytest.raises(BackendError, match=r"pressure of valve 1: .*No such file"):
        valves.read()
    away.rename(IIO_DEVICES)
    valves.write([0.0] * NUM_VALVES)
    assert [output(channel) for channel in range(NUM_VALVES)] == [0] * NUM_VALVES
    assert len(valves.read()) == NUM_VALVES
    valves.close()


@with_devices
def test_command_vents_what_a_board_that_died_has_left(tmp_path: Path) -> None:
    valves = IioValves(CONVERTERS)
    valves.write([FULL_SCALE] * NUM_VALVES)
    config = tmp_path / "board.yaml"
    config.write_text(yaml.safe_dump({"iio": CONVERTERS.model_dump(mode="json")}))
    result = CliRunner().invoke(app, ["board", str(config), "--vent"])
    assert result.exit_code == 0, result.output
    assert [output(channel) for channel in range(NUM_VALVES)] == [0] * NUM_VALVES
    valves.close()


@pytest.mark.parametrize(
    ("wrapper", "remedy"),
    [
        ("raise ImportError('no iio')", 'pip install "pylibiio'),
        ("raise OSError(2, 'Could not find libiio C library')", "apt-get install libiio0"),
        ("import ctypes; ctypes.CDLL(None).iio_get_backends_count", "apt-get install libiio0"),
    ],
)
def test_missing_library_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wrapper: str, remedy: str) -> None:
    (tmp_path / "iio.py").write_text(wrapper)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "iio", raising=False)
    with pytest.raises(MissingToolError, match=remedy):
        IioValves(CONVERTERS)


@given(pressure=st.floats(-1e7, 1e7))
def test_no_target_leaves_the_range_of_the_codes(pressure: float) -> None:
    config = ConverterConfig(device="", full_scale=FULL_SCALE, zero_code=100, highest_code=4000)
    assert 100 <= _code(config, pressure) <= 4000


def test_converter_without_a_range_of_codes_is_refused() -> None:
    with pytest.raises(ValidationError, match="not above zero_code"):
        ConverterConfig(device="x", full_scale=1.0, zero_code=10, highest_code=10)


def test_simulated_valves_follow_at_once() -> None:
    valves = SimulatedValves()
    valves.write([1.0] * NUM_VALVES)
    assert list(valves.read()) == [1.0] * NUM_VALVES
