"""The jump-and-hit motion: from the motion parameter theta to the time series of commands U (Sec. III, V-D).

Phases are counted from 1 as in the paper. Phase i lasts from the end of phase i - 1 (the onset for i = 1) to t_i,
its own end excluded.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from imolo.config.model import Model
from imolo.errors import ConfigError, MessageError
from imolo_msgs import valve_command_t

Array = NDArray[np.float64]

NUM_VALVES = 8  # Sec. V-B
SUPPLY_PRESSURE = 0.9e6  # [Pa] gauge, Sec. VII-B: no valve can be asked for more

_VENTED = np.zeros(NUM_VALVES)
_VENTED.flags.writeable = False

_Pressure = Annotated[float, Field(ge=0.0, le=SUPPLY_PRESSURE)]
_Pressures = tuple[_Pressure, _Pressure, _Pressure, _Pressure, _Pressure, _Pressure, _Pressure, _Pressure]
_PressureSteps = tuple[float, float, float, float, float, float, float, float]


class Theta(NamedTuple):
    """The motion parameter (Eq. 3): k [-] of Eq. 1 and the w-th switching time t_w [s] since the onset."""

    k: float
    t_w: float


# Table III, motions 1 to 15.
TRAINING_MOTIONS: tuple[Theta, ...] = (
    Theta(k=1.000, t_w=0.210),
    Theta(k=-1.000, t_w=0.210),
    Theta(k=1.000, t_w=0.410),
    Theta(k=-1.000, t_w=0.410),
    Theta(k=0.833, t_w=0.373),
    Theta(k=-0.427, t_w=0.259),
    Theta(k=0.513, t_w=0.396),
    Theta(k=0.507, t_w=0.280),
    Theta(k=-0.240, t_w=0.249),
    Theta(k=0.133, t_w=0.260),
    Theta(k=-0.847, t_w=0.333),
    Theta(k=-0.893, t_w=0.305),
    Theta(k=0.060, t_w=0.280),
    Theta(k=0.560, t_w=0.376),
    Theta(k=0.867, t_w=0.327),
)


def to_microseconds(time: float) -> int:
    """Round a time [s] to the whole microseconds of the messages."""
    return round(time * 1e6)


@dataclass(frozen=True, eq=False)
class Commands:
    """The time series of the control target U (Sec. III), on the clock of the messages.

    Attributes:
        onset_utime: Start of phase 1 [µs].
        switch_utime: End of each phase [µs], strictly increasing, shape (P,).
        target_pressure: Target gauge pressure of the valves 1..8 in each phase [Pa], shape (P, 8), read-only.

    Raises:
        MessageError: The shapes disagree, a pressure is not finite, or the times do not increase.
    """

    onset_utime: int
    switch_utime: tuple[int, ...]
    target_pressure: Array

    def __post_init__(self) -> None:
        pressure = np.array(self.target_pressure, dtype=np.float64)
        pressure.flags.writeable = False
        object.__setattr__(self, "target_pressure", pressure)
        phases = len(self.switch_utime)
        if phases == 0:
            raise MessageError("commands have no phases; give at least one switch time")
        if pressure.shape != (phases, NUM_VALVES):
            raise MessageError(
                f"target_pressure has shape {pressure.shape}; give one row of {NUM_VALVES} valves for each of the "
                f"{phases} phases"
            )
        if not np.isfinite(pressure).all():
            phase, valve = np.argwhere(~np.isfinite(pressure))[0]
            raise MessageError(
                f"target_pressure of valve {valve + 1} in phase {phase + 1} is {pressure[phase, valve]}; "
                "give a finite gauge pressure [Pa]"
            )
        for earlier, later in pairwise((self.onset_utime, *self.switch_utime)):
            if later <= earlier:
                raise MessageError(
                    f"switch_utime {later} does not come after {earlier}; give strictly increasing times [µs] after "
                    f"onset_utime {self.onset_utime}"
                )

    def __eq__(self, other: object) -> bool:
        """Return whether onset, switch times and pressures are all equal."""
        if not isinstance(other, Commands):
            return NotImplemented
        return (
            self.onset_utime == other.onset_utime
            and self.switch_utime == other.switch_utime
            and np.array_equal(self.target_pressure, other.target_pressure)
        )

    __hash__ = None  # type: ignore[assignment]

    @property
    def end_utime(self) -> int:
        """End of the last phase [µs]."""
        return self.switch_utime[-1]

    def target(self, utime: int) -> Array | None:
        """Return the control target u in force at a time.

        Args:
            utime: Time [µs].

        Returns:
            Target gauge pressures [Pa], shape (8,), read-only; zeros (vented) from the end on; None before the onset,
            where the valves hold a rest pressure that U does not know.
        """
        if utime < self.onset_utime:
            return None
        phase = bisect_right(self.switch_utime, utime)
        return _VENTED if phase == len(self.switch_utime) else self.target_pressure[phase]

    def matches_until(self, other: "Commands", utime: int) -> bool:
        """Return whether both command the same before a time, so that one may replace the other then (Fig. 4e).

        Args:
            other: The commands to compare with.
            utime: End of the executed part, itself excluded ("prior to time t_e", Sec. IV-B3) [µs]; give the earliest
                time at which new commands can take effect.
        """
        changes = {self.onset_utime, other.onset_utime, *self.switch_utime, *other.switch_utime}
        return all(_same_target(self.target(at), other.target(at)) for at in changes if at < utime)

    def to_message(self, utime: int, command_sequence: int) -> valve_command_t:
        """Return the message that carries these commands.

        Args:
            utime: Time of the mocap frame the commands answer [µs].
            command_sequence: Number of the message.
        """
        message = valve_command_t()
        message.utime = utime
        message.command_sequence = command_sequence
        message.onset_utime = self.onset_utime
        message.num_phases = len(self.switch_utime)
        message.switch_utime = list(self.switch_utime)
        message.target_pressure = self.target_pressure.tolist()
        return message

    @classmethod
    def from_message(cls, message: valve_command_t, max_pressure: float = SUPPLY_PRESSURE) -> Self:
        """Read and check a message.

        Args:
            message: The message.
            max_pressure: Highest gauge pressure a valve may be asked for [Pa].

        Raises:
            MessageError: A value cannot be used.
        """
        for name in ("switch_utime", "target_pressure"):
            length = len(getattr(message, name))
            if length != message.num_phases:
                raise MessageError(f"{name} has {length} entries; num_phases promises {message.num_phases}")
        for phase, row in enumerate(message.target_pressure, start=1):
            if len(row) != NUM_VALVES:
                raise MessageError(f"target_pressure of phase {phase} has {len(row)} values; give {NUM_VALVES}")
        commands = cls(message.onset_utime, tuple(message.switch_utime), np.array(message.target_pressure, dtype=float))
        pressure = commands.target_pressure
        outside = (pressure < 0.0) | (pressure > max_pressure)
        if outside.any():
            index, valve = np.argwhere(outside)[0]
            raise MessageError(
                f"target_pressure of valve {valve + 1} in phase {index + 1} is {pressure[index, valve]:g} Pa; "
                f"give 0 to {max_pressure:g} Pa"
            )
        return commands


def _same_target(a: Array | None, b: Array | None) -> bool:
    if a is None or b is None:
        return a is b
    return np.array_equal(a, b)


class MotionTemplate(Model):
    """Everything of U that theta does not change; the defaults are Table II.

    Attributes:
        u_m: Centre of the changed control target (Eq. 1), gauge [Pa], shape (8,).
        u_k: Change of the control target per unit of k (Eq. 1) [Pa], shape (8,).
        changed_phase: c, the phase whose control target follows Eq. 1.
        switch_phase: w, the phase that ends at t_w.
        fixed_target: Control targets of the other phases than c in their order, gauge [Pa], shape (P - 1, 8).
        fixed_switch_time: Ends of the other phases than w in their order, since the onset [s], shape (P - 1,).
        k_range: Lowest and highest k [-] (Sec. VII-B).
    """

    u_m: _Pressures = (0.5e5, 2.5e5, 0.2e5, 0.5e5, 2.5e5, 0.2e5, 0.0, 0.5e5)
    u_k: _PressureSteps = (0.0, 1.5e5, 0.0, 0.0, -1.5e5, 0.0, 0.0, 0.0)
    changed_phase: int = Field(default=1, ge=1)
    switch_phase: int = Field(default=2, ge=1)
    fixed_target: tuple[_Pressures, ...] = (
        (6.0e5, 4.0e5, 1.0e5, 6.0e5, 4.0e5, 1.0e5, 0.0, 0.5e5),
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0e5, 0.0),
    )
    fixed_switch_time: tuple[float, ...] = (0.10, 1.20)
    k_range: tuple[float, float] = (-1.0, 1.0)

    @model_validator(mode="after")
    def _check(self) -> Self:
        phases = self.num_phases
        if len(self.fixed_switch_time) != phases - 1:
            raise ValueError(
                f"fixed_switch_time has {len(self.fixed_switch_time)} times; give {phases - 1}, one per fixed_target"
            )
        if self.changed_phase > phases:
            raise ValueError(f"changed_phase is {self.changed_phase}; give 1 to {phases}")
        if self.switch_phase >= phases:
            raise ValueError(
                f"switch_phase is {self.switch_phase}; give 1 to {phases - 1}: the last phase ends the motion"
            )
        _check_increasing((0.0, *self.fixed_switch_time), "fixed_switch_time")
        if not self.k_range[0] < self.k_range[1]:
            raise ValueError(f"k_range is {self.k_range}; give the lower bound first")
        for k in self.k_range:
            pressure = self._changed_target(k)
            if not ((pressure >= 0.0) & (pressure <= SUPPLY_PRESSURE)).all():
                raise ValueError(f"u_m + k u_k leaves 0 to {SUPPLY_PRESSURE:g} Pa at k = {k:g}; narrow k_range")
        return self

    @property
    def num_phases(self) -> int:
        """Number of phases P."""
        return len(self.fixed_target) + 1

    @property
    def t_w_range(self) -> tuple[float, float]:
        """Bounds of t_w since the onset [s], themselves excluded: the switch times before and after it."""
        times = (0.0, *self.fixed_switch_time)
        return times[self.switch_phase - 1], times[self.switch_phase]

    def changed_phase_start(self, t_w: float) -> float:
        """Return when phase c starts since the onset [s]: from then on an executed motion cannot change its k."""
        if self.changed_phase == 1:
            return 0.0
        return self._switch_time(t_w)[self.changed_phase - 2]

    def commands(self, theta: Theta, onset_utime: int) -> Commands:
        """Create U from theta (Eqs. 1, 3).

        Args:
            theta: Motion parameter.
            onset_utime: Onset of the motion [µs].

        Raises:
            ConfigError: k or t_w is out of range.
        """
        k, t_w = theta
        lowest, highest = self.k_range
        if not lowest <= k <= highest:
            raise ConfigError(f"k is {k:g}; give {lowest:g} to {highest:g}")
        after, before = self.t_w_range
        if not (np.isfinite(t_w) and to_microseconds(after) < to_microseconds(t_w) < to_microseconds(before)):
            raise ConfigError(f"t_w is {t_w:g} s; give more than {after:g} s and less than {before:g} s")
        target: list[Any] = list(self.fixed_target)
        target.insert(self.changed_phase - 1, self._changed_target(k))
        switch_utime = tuple(onset_utime + to_microseconds(time) for time in self._switch_time(t_w))
        return Commands(onset_utime, switch_utime, np.array(target, dtype=np.float64))

    def _changed_target(self, k: float) -> Array:
        return np.array(self.u_m) + k * np.array(self.u_k)

    def _switch_time(self, t_w: float) -> tuple[float, ...]:
        before, after = self.fixed_switch_time[: self.switch_phase - 1], self.fixed_switch_time[self.switch_phase - 1 :]
        return (*before, t_w, *after)


def _check_increasing(times: Sequence[float], name: str) -> None:
    for earlier, later in pairwise(times):
        if not to_microseconds(earlier) < to_microseconds(later):
            raise ValueError(f"{name} has {later:g} s after {earlier:g} s; give strictly increasing times above 0 s")
