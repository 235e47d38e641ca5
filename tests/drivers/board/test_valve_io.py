"""The converters of the board as the Linux kernel shows them: a folder with a file per channel."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from imolo.errors import BackendError
from imolo.method.motion import NUM_VALVES
from imolo_drivers.valve_io import ConverterConfig, IioConfig, IioValves, SimulatedValves, _code

FULL_SCALE = 1.0e6  # [Pa]


@pytest.fixture
def devices(tmp_path: Path) -> IioConfig:
    dac, adc = tmp_path / "iio:device0", tmp_path / "iio:device1"
    for folder, name in ((dac, "out_voltage{}_raw"), (adc, "in_voltage{}_raw")):
        folder.mkdir()
        for channel in range(NUM_VALVES):
            (folder / name.format(channel)).write_text("0\n")
    return IioConfig(
        dac=ConverterConfig(device=str(dac), full_scale=FULL_SCALE, channels=tuple(reversed(range(NUM_VALVES)))),
        adc=ConverterConfig(device=str(adc), full_scale=FULL_SCALE, zero_code=400, highest_code=4000),
    )


def output(devices: IioConfig, channel: int) -> int:
    # The kernel takes each write as a whole; in a file the rest of a longer one stays.
    return int((Path(devices.dac.device) / f"out_voltage{channel}_raw").read_text().split("\n")[0])


def test_targets_become_the_nearest_codes_on_the_wired_channels(devices: IioConfig) -> None:
    valves = IioValves(devices)
    valves.write([FULL_SCALE, *[0.5 * FULL_SCALE] * 6, 1.0e4])
    assert output(devices, 7) == 4095
    assert output(devices, 3) == 2048
    assert output(devices, 0) == round(4095 * 0.01)
    valves.close()


@given(pressure=st.floats(-1e7, 1e7))
def test_no_target_leaves_the_range_of_the_codes(pressure: float) -> None:
    config = ConverterConfig(device="", full_scale=FULL_SCALE, zero_code=100, highest_code=4000)
    assert 100 <= _code(config, pressure) <= 4000


def test_codes_of_the_sensors_become_pressures(devices: IioConfig) -> None:
    (Path(devices.adc.device) / "in_voltage2_raw").write_text("2200\n")
    valves = IioValves(devices)
    assert valves.read()[2] == pytest.approx(0.5 * FULL_SCALE)
    assert valves.read()[0] == pytest.approx(-FULL_SCALE / 9.0)
    valves.close()


def test_missing_device_is_told(devices: IioConfig) -> None:
    missing = devices.model_copy(update={"dac": devices.dac.model_copy(update={"device": "/nowhere"})})
    with pytest.raises(BackendError, match="/nowhere/out_voltage7_raw: No such file"):
        IioValves(missing)


def test_sensor_that_says_no_number_is_told(devices: IioConfig) -> None:
    (Path(devices.adc.device) / "in_voltage4_raw").write_text("busy\n")
    valves = IioValves(devices)
    with pytest.raises(BackendError, match="pressure of valve 5"):
        valves.read()
    valves.close()


def test_converter_without_a_range_of_codes_is_refused() -> None:
    with pytest.raises(ValidationError, match="not above zero_code"):
        ConverterConfig(device="x", full_scale=1.0, zero_code=10, highest_code=10)


def test_simulated_valves_follow_at_once() -> None:
    valves = SimulatedValves()
    valves.write([1.0] * NUM_VALVES)
    assert list(valves.read()) == [1.0] * NUM_VALVES
