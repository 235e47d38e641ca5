"""The wires of the valve board: eight pressures out through a DAC, eight in through an ADC."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Protocol, Self

from pydantic import Field, model_validator

from imolo.config.model import Model, Positive
from imolo.errors import BackendError
from imolo.method.motion import NUM_VALVES

_Channels = Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=NUM_VALVES, max_length=NUM_VALVES)]


class ValveIO(Protocol):
    """Gives the valves their targets and measures the pressures behind them."""

    def write(self, pressure: Sequence[float]) -> None:
        """Give the valves their target gauge pressures [Pa], shape (8,).

        Raises:
            BackendError: The converter does not take them.
        """

    def read(self) -> Sequence[float]:
        """Return the gauge pressures behind the valves [Pa], shape (8,).

        Raises:
            BackendError: The converter does not answer.
        """

    def close(self) -> None:
        """Let the converters go; the caller has vented before."""


class SimulatedValves:
    """Valves that follow at once, for trying the board without any."""

    def __init__(self) -> None:
        """Start vented."""
        self.pressure: Sequence[float] = (0.0,) * NUM_VALVES

    def write(self, pressure: Sequence[float]) -> None:
        """Follow at once."""
        self.pressure = tuple(pressure)

    def read(self) -> Sequence[float]:
        """Return what was written last."""
        return self.pressure

    def close(self) -> None:
        """Do nothing."""


class ConverterConfig(Model):
    """A DAC or an ADC that the Linux kernel drives as an IIO device; SPI or I²C makes no difference here."""

    device: str = Field(description="folder of the device, such as /sys/bus/iio/devices/iio:device0")
    channels: _Channels = Field(tuple(range(NUM_VALVES)), description="number of the channel of the valves 1..8")
    full_scale: Positive = Field(description="gauge pressure at the highest code [Pa], from the valve's data sheet")
    zero_code: Annotated[int, Field(ge=0)] = Field(0, description="code at 0 Pa; sensors often begin at a tenth")
    highest_code: Annotated[int, Field(gt=0)] = Field(4095, description="code at full_scale; 4095 for 12 bit")

    @model_validator(mode="after")
    def _codes_span_a_range(self) -> Self:
        if self.highest_code <= self.zero_code:
            raise ValueError(f"highest_code {self.highest_code} is not above zero_code {self.zero_code}")
        return self


class IioConfig(Model):
    """The two converters of the board."""

    dac: ConverterConfig
    adc: ConverterConfig


class IioValves:
    """Valves and sensors behind IIO devices of the Linux kernel.

    The kernel's interface is one file per channel that holds a number (Documentation/ABI/testing/sysfs-bus-iio), so
    that no library is needed. The files stay open.
    """

    def __init__(self, config: IioConfig) -> None:
        """Open the converters.

        Raises:
            BackendError: A device or a channel is not there, or may not be written.
        """
        self._dac, self._adc = config.dac, config.adc
        self._files: list[int] = []
        try:
            self._outputs = [self._open(config.dac, f"out_voltage{n}_raw", os.O_WRONLY) for n in config.dac.channels]
            self._inputs = [self._open(config.adc, f"in_voltage{n}_raw", os.O_RDONLY) for n in config.adc.channels]
        except BackendError:
            self.close()
            raise
        self._codes: list[int | None] = [None] * NUM_VALVES

    def write(self, pressure: Sequence[float]) -> None:
        """Write the codes that have changed."""
        for valve, value in enumerate(pressure):
            code = _code(self._dac, value)
            if code == self._codes[valve]:
                continue
            self._codes[valve] = None
            try:
                os.pwrite(self._outputs[valve], b"%d" % code, 0)
            except OSError as error:
                raise BackendError(f"the DAC does not take code {code} for valve {valve + 1}: {error}") from error
            self._codes[valve] = code

    def read(self) -> Sequence[float]:
        """Read all channels, one after the other."""
        pressures = []
        span = self._adc.highest_code - self._adc.zero_code
        for valve, file in enumerate(self._inputs):
            try:
                code = int(os.pread(file, 32, 0))
            except (OSError, ValueError) as error:
                raise BackendError(f"the ADC does not tell the pressure of valve {valve + 1}: {error}") from error
            pressures.append((code - self._adc.zero_code) / span * self._adc.full_scale)
        return pressures

    def close(self) -> None:
        """Close the files."""
        while self._files:
            os.close(self._files.pop())

    def _open(self, converter: ConverterConfig, name: str, mode: int) -> int:
        path = Path(converter.device) / name
        try:
            file = os.open(path, mode)
        except OSError as error:
            raise BackendError(
                f"cannot open {path}: {error.strerror}; see /sys/bus/iio/devices/*/name for what is there"
            ) from error
        self._files.append(file)
        return file


def _code(dac: ConverterConfig, pressure: float) -> int:
    """Return the nearest code that the DAC has."""
    code = dac.zero_code + round(pressure / dac.full_scale * (dac.highest_code - dac.zero_code))
    return min(max(code, dac.zero_code), dac.highest_code)
