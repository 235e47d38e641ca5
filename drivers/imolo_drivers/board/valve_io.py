"""The wires of the valve board: targets out through a DAC, measurements in through an ADC."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Protocol, Self

from pydantic import Field, model_validator

from imolo.config.model import Model, Positive
from imolo.errors import BackendError, MissingToolError, did_you_mean
from imolo.machine.extras import import_extra

_Channels = Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)]

IIO_DEVICES = Path("/sys/bus/iio/devices")  # where the kernel has them, and libiio looks


class ValveIO(Protocol):
    """Gives the valves their targets and measures the pressures behind them.

    `read` is called in a thread of its own, at the same time as the others, and may take as long as it likes.
    """

    def write(self, pressure: Sequence[float]) -> None:
        """Give the valves their targets, such as gauge pressures [Pa], shape (N,).

        Raises:
            BackendError: The converter does not take them.
        """

    def read(self) -> Sequence[float]:
        """Return what is measured behind the valves, such as gauge pressures [Pa], shape (N,).

        Raises:
            BackendError: The converter does not answer.
        """

    def close(self) -> None:
        """Let the converters go; the caller has vented before."""


class SimulatedValves:
    """Valves that follow at once, for trying the board without any."""

    def __init__(self) -> None:
        """Know no targets before the board gives them."""
        self.pressure: Sequence[float] = ()

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

    device: str = Field(description="its name, such as ad5628-1, or label or id, as `iio_info` lists it")
    channels: _Channels = Field(
        tuple(range(8)), description="numbers of the converter's channels in the order of the board's"
    )
    full_scale: Positive = Field(description="target or measurement at highest_code [unit], from the data sheet")
    zero_code: Annotated[int, Field(ge=0)] = Field(0, description="code at 0; sensors often begin at a tenth")
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
    """Valves and sensors behind IIO devices of the Linux kernel, by libiio."""

    def __init__(self, config: IioConfig) -> None:
        """Find the converters.

        Raises:
            MissingToolError: libiio or its Python package is not installed.
            BackendError: A device or a channel is not there.
        """
        self._dac, self._adc = config.dac, config.adc
        iio = _libiio()
        # Without devices the package complains of itself, too.
        if not any(IIO_DEVICES.glob("iio:device*")):
            raise BackendError(
                f"there are no IIO devices under {IIO_DEVICES}; are the drivers of the converters loaded?"
            )
        # Kept: channels and codes point into them, and nothing else keeps them alive. One for each thread.
        self._contexts = (iio.LocalContext(), iio.LocalContext())
        self._outputs = _codes(self._contexts[0], config.dac, is_output=True)
        self._inputs = _codes(self._contexts[1], config.adc, is_output=False)
        self._written: list[int | None] = [None] * len(self._outputs)

    def write(self, pressure: Sequence[float]) -> None:
        """Write the codes that have changed."""
        for valve, value in enumerate(pressure):
            code = _code(self._dac, value)
            if code == self._written[valve]:
                continue
            self._written[valve] = None
            try:
                self._outputs[valve].value = str(code)
            except OSError as error:
                raise BackendError(f"the DAC does not take code {code} for valve {valve + 1}: {error}") from error
            self._written[valve] = code

    def read(self) -> Sequence[float]:
        """Read all channels, one after the other."""
        pressures = []
        span = self._adc.highest_code - self._adc.zero_code
        for valve, channel in enumerate(self._inputs):
            try:
                code = int(channel.value)
            except (OSError, ValueError) as error:
                raise BackendError(f"the ADC does not tell the pressure of valve {valve + 1}: {error}") from error
            pressures.append((code - self._adc.zero_code) / span * self._adc.full_scale)
        return pressures

    def close(self) -> None:
        """Let the devices go."""
        self._outputs, self._inputs = [], []
        del self._contexts


def _libiio() -> Any:
    """Import the package that wraps libiio.

    Raises:
        MissingToolError: It or libiio is not installed.
    """
    try:
        return import_extra("iio", "iio")
    except (OSError, AttributeError) as error:  # what it raises depends on its version
        raise MissingToolError(f"libiio cannot be used: {error}; on Debian, apt-get install libiio0") from error


def _codes(context: Any, converter: ConverterConfig, *, is_output: bool) -> list[Any]:
    """Return what holds the code of each valve's channel."""
    device = context.find_device(converter.device)
    if device is None:
        known = [found.name or found.id for found in context.devices]
        raise BackendError(
            f"there is no IIO device {converter.device!r}{did_you_mean(converter.device, known)}; "
            f"there are: {', '.join(known) or 'none'}"
        )
    codes = []
    for number in converter.channels:
        channel = device.find_channel(f"voltage{number}", is_output)
        if channel is None or "raw" not in channel.attrs:
            kind = "output" if is_output else "input"
            raise BackendError(f"{converter.device} has no {kind} voltage{number} with a code; see `iio_info`")
        codes.append(channel.attrs["raw"])
    return codes


def _code(dac: ConverterConfig, pressure: float) -> int:
    """Return the nearest code that the DAC has."""
    code = dac.zero_code + round(pressure / dac.full_scale * (dac.highest_code - dac.zero_code))
    return min(max(code, dac.zero_code), dac.highest_code)
