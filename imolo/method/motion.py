"""Motion templates: from the motion parameter theta to the time series of commands U (Secs. III, V-D).

What IMoLo needs of a motion is a vector of parameters, U made from it, and from when on each parameter shows in U, so
that it can tell which part of a motion is executed already. Any subclass of `MotionTemplate` says so much;
`PhasedMotion` is the paper's, with any number of channels, phases and parameters.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from operator import itemgetter
from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from imolo.config.model import Model
from imolo.errors import ConfigError, MessageError
from imolo.method.commands import Commands, to_microseconds

Array = NDArray[np.float64]

Theta = tuple[float, ...]
"""A motion parameter, one number per entry of `MotionTemplate.parameters`."""

Row = tuple[float, ...]
"""A theta, then from when on each of its parameters shows in U [s]; 2 n numbers."""


class Parameter(Model):
    """One entry of theta.

    Attributes:
        name: As in the paper or in the field, such as "k".
        unit: SI unit; empty for a number.
        range: Lowest and highest value; for the end of a phase, everything between the ends around it if not given.
        mirrored: Whether its sign changes in the mirrored motion, that of the other hand.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z]\w*$")]
    unit: str = ""
    range: tuple[float, float] | None = None
    mirrored: bool = False

    @model_validator(mode="after")
    def _check_range(self) -> Self:
        if self.range is not None and not self.range[0] < self.range[1]:
            raise ValueError(f"range of {self.name} is {self.range}; give the lower bound first")
        return self


class MotionTemplate(Model):
    """What makes U of theta; a subclass with settings of its own is a field of the robot's config."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The entries of theta, one to four."""
        raise NotImplementedError

    def commands(self, theta: Sequence[float], onset_utime: int) -> Commands:
        """Create U from theta.

        Args:
            theta: Motion parameter, one value per entry of `parameters`.
            onset_utime: Onset of the motion [µs].

        Raises:
            ConfigError: A value is out of range.
        """
        raise NotImplementedError

    def shows_from(self, theta: ArrayLike) -> Array:
        """Return from when on each parameter shows in U, since the onset [s]: later it cannot be changed any more.

        Args:
            theta: Motion parameters, shape (N, n).

        Returns:
            Times [s], shape (N, n).
        """
        raise NotImplementedError

    def swing_start(self, theta: ArrayLike) -> Array:
        """Return when the part of the motion begins in which an effector may meet the object, since the onset [s].

        Samples, predictions and the times of a table are counted from here; t_w in the paper.

        Args:
            theta: Motion parameters, shape (N, n).

        Returns:
            Times [s], shape (N,).
        """
        raise NotImplementedError

    def row_maker(self) -> Callable[[Theta], Row]:
        """Return what makes the row of one theta."""
        return partial(_row, self)

    def last_change(self, theta: Sequence[float]) -> float:
        """Return until when since the onset some parameter can still be changed [s]."""
        return float(self.shows_from([theta]).max())

    def swing_of(self, theta: Sequence[float]) -> float:
        """Return `swing_start` of one theta [s]."""
        return float(self.swing_start([theta])[0])

    @property
    def mirror(self) -> Array | None:
        """Sign of each parameter in the mirrored motion, shape (n,); None where there is no mirrored motion."""
        mirrored = [parameter.mirrored for parameter in self.parameters]
        return np.where(mirrored, -1.0, 1.0) if any(mirrored) else None

    def rounded(self, theta: Sequence[float]) -> Theta:
        """Return theta with its times rounded to the microseconds of the messages."""
        return tuple(
            round(value, 6) if parameter.unit == "s" else value
            for parameter, value in zip(self.parameters, theta, strict=True)
        )

    def label(self, theta: Sequence[float]) -> str:
        """Return theta for people, such as "k = 0.5, t_w = 0.3 s"."""
        pairs = zip(self.parameters, theta, strict=True)
        return ", ".join(f"{one.name} = {value:g} {one.unit}".rstrip() for one, value in pairs)


class Phase(Model):
    """One control target and until when it holds.

    Attributes:
        target: Of every channel, in its unit, shape (C,); u_m of Eq. 1 where a parameter changes it.
        until: End of the phase since the onset [s]; None where a parameter is the end.
    """

    target: Annotated[tuple[float, ...], Field(min_length=1)]
    until: float | None = None


class PhaseParameter(Parameter):
    """A parameter of a `PhasedMotion`: it changes a target, or ends a phase.

    Attributes:
        phase: Which phase, counted from 1: c of Eq. 1, or w of Eq. 3.
        also: Later phases whose targets change alike.
        direction: Added to the target of the phase, times the value (u_k of Eq. 1), shape (C,); None for a parameter
            that is the end of the phase.
    """

    phase: Annotated[int, Field(ge=1)]
    also: tuple[Annotated[int, Field(ge=1)], ...] = ()
    direction: tuple[float, ...] | None = None

    @property
    def changed_phases(self) -> tuple[int, ...]:
        """All phases whose target it changes, counted from 1; none for the end of a phase."""
        return () if self.direction is None else (self.phase, *self.also)


class PhasedMotion(MotionTemplate):
    """The switched control targets of the paper (Fig. 2b, Eqs. 1, 3): u_c = u_m + k u_k, and a free end t_w.

    Attributes:
        phases: In their order.
        varied: What theta changes.
        swing_phase: In which an effector may meet the object, counted from 1.
        target_range: Lowest and highest target of any channel; any if not given.
    """

    phases: Annotated[tuple[Phase, ...], Field(min_length=1)]
    varied: Annotated[tuple[PhaseParameter, ...], Field(min_length=1, max_length=4)]
    swing_phase: Annotated[int, Field(ge=1)]
    target_range: tuple[float, float] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        count, width = len(self.phases), len(self.phases[0].target)
        names = [one.name for one in self.varied]
        if len(set(names)) < len(names):
            raise ValueError(f"varied names {', '.join(names)}; give each parameter a name of its own")
        if self.swing_phase > count:
            raise ValueError(f"swing_phase is {self.swing_phase}; give 1 to {count}")
        for number, phase in enumerate(self.phases, start=1):
            if len(phase.target) != width:
                raise ValueError(f"phase {number} has {len(phase.target)} targets, the first one {width}")
            ends = [one.name for one in self.varied if one.direction is None and one.phase == number]
            if (phase.until is None) != (len(ends) == 1):
                raise ValueError(
                    f"phase {number} ends at {phase.until} and by {ends or 'no parameter'}; give it one end, "
                    "`until` or a parameter without direction"
                )
        if self.phases[-1].until is None:
            raise ValueError("the last phase ends the motion; give it an `until`")
        for one in self.varied:
            self._check_parameter(one, count, width)
        fixed = [phase.until for phase in self.phases if phase.until is not None]
        if any(
            to_microseconds(late) <= to_microseconds(early) for early, late in zip((0.0, *fixed), fixed, strict=False)
        ):
            raise ValueError(f"the phases end at {fixed} s; give strictly increasing times above 0 s")
        if self.target_range is not None:
            self._check_targets(*self.target_range)
        return self

    def _check_parameter(self, one: PhaseParameter, count: int, width: int) -> None:
        if (last := max((one.phase, *one.also))) > count:
            raise ValueError(f"{one.name} changes phase {last}; give 1 to {count}")
        if any(late <= one.phase for late in one.also):
            raise ValueError(f"{one.name} changes phase {one.phase} and also {one.also}; give later ones")
        if one.direction is not None and len(one.direction) != width:
            raise ValueError(f"direction of {one.name} has {len(one.direction)} values; give {width}, one per channel")
        if one.direction is not None and one.range is None:
            raise ValueError(f"{one.name} has no range; give its lowest and highest value")

    def _check_targets(self, low: float, high: float) -> None:
        for number, phase in enumerate(self.phases, start=1):
            least, most = np.array(phase.target), np.array(phase.target)
            for one in self.varied:
                if number in one.changed_phases and one.direction is not None and one.range is not None:
                    ends = np.outer(one.range, one.direction)
                    least, most = least + ends.min(axis=0), most + ends.max(axis=0)
            if not (low <= least.min() and most.max() <= high):
                raise ValueError(
                    f"the targets of phase {number} reach {least.min():g} to {most.max():g}; narrow a range to keep "
                    f"them within {low:g} to {high:g}"
                )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The entries of theta."""
        return self.varied

    def commands(self, theta: Sequence[float], onset_utime: int) -> Commands:
        """Create U from theta (Eqs. 1, 3).

        Raises:
            ConfigError: There are too few or too many values, or one is out of range.
        """
        if len(theta) != len(self.varied):
            names = ", ".join(one.name for one in self.varied)
            raise ConfigError(f"theta is {tuple(theta)}; give {len(self.varied)} values: {names}")
        # Without arrays: a planner does this once a ball, where NumPy's code is in no cache.
        targets = [phase.target for phase in self.phases]
        ends: list[float] = [math.nan if phase.until is None else phase.until for phase in self.phases]
        for one, value in zip(self.varied, theta, strict=True):
            self._check_value(one, value)
            if one.direction is None:
                ends[one.phase - 1] = value
                continue
            for phase in one.changed_phases:
                target = zip(targets[phase - 1], one.direction, strict=True)
                targets[phase - 1] = tuple(before + value * change for before, change in target)
        switch_utime = tuple(onset_utime + to_microseconds(time) for time in ends)
        try:
            return Commands(onset_utime, switch_utime, np.array(targets))
        except MessageError as error:
            raise ConfigError(f"{self.label(theta)} is no motion: {error}") from error

    def shows_from(self, theta: ArrayLike) -> Array:
        """Return from when on each parameter shows in U [s], shape (N, n)."""
        ends = self._ends(np.asarray(theta, dtype=np.float64))
        starts = np.column_stack((np.zeros(len(ends)), ends))
        # A changed target shows from the start of its phase, a changed end from that end on.
        return np.column_stack([(ends if one.direction is None else starts)[:, one.phase - 1] for one in self.varied])

    def row_maker(self) -> Callable[[Theta], Row]:
        """Return what makes the row of one theta, in a tenth of the time that `shows_from` takes."""
        count = len(self.varied)
        fixed = 0.0, *(phase.until or 0.0 for phase in self.phases)
        # Where the end of each phase is found in theta with the fixed ends behind it.
        places = list(range(count, count + len(fixed)))
        for column, one in enumerate(self.varied):
            if one.direction is None:
                places[one.phase] = column
        shown = [places[one.phase - (one.direction is not None)] for one in self.varied]
        return partial(_picked_row, itemgetter(*range(count), *shown), fixed)

    def swing_start(self, theta: ArrayLike) -> Array:
        """Return when `swing_phase` begins [s], shape (N,)."""
        ends = self._ends(np.asarray(theta, dtype=np.float64))
        return ends[:, self.swing_phase - 2] if self.swing_phase > 1 else np.zeros(len(ends))

    def bounds(self, one: PhaseParameter) -> tuple[float, float]:
        """Return the lowest and the highest value of a parameter; the ends around it, themselves excluded, if open."""
        if one.range is not None:
            return one.range
        before = [phase.until for phase in self.phases[: one.phase - 1] if phase.until is not None]
        after = [phase.until for phase in self.phases[one.phase :] if phase.until is not None]
        return (before[-1] if before else 0.0), after[0]

    def _check_value(self, one: PhaseParameter, value: float) -> None:
        low, high = self.bounds(one)
        unit = f" {one.unit}".rstrip()
        if one.direction is None and one.range is None:
            inside = math.isfinite(value) and to_microseconds(low) < to_microseconds(value) < to_microseconds(high)
            if not inside:
                raise ConfigError(
                    f"{one.name} is {value:g}{unit}; give more than {low:g}{unit} and less than {high:g}{unit}"
                )
        elif not low <= value <= high:
            raise ConfigError(f"{one.name} is {value:g}{unit}; give {low:g} to {high:g}{unit}")

    def _ends(self, theta: Array) -> Array:
        """Return the ends of all phases [s], shape (N, P)."""
        ends = np.tile([np.nan if phase.until is None else phase.until for phase in self.phases], (len(theta), 1))
        for column, one in enumerate(self.varied):
            if one.direction is None:
                ends[:, one.phase - 1] = theta[:, column]
        return ends


def motion_rows(template: MotionTemplate, theta: Array) -> Array:
    """Return each theta, then from when on its parameters show in U [µs], as the compiled searches take it.

    Args:
        template: Of the motions.
        theta: Shape (N, n).

    Returns:
        Shape (N, 2 n), C-contiguous.
    """
    return np.ascontiguousarray(np.column_stack((theta, np.rint(template.shows_from(theta) * 1e6))))


def _row(template: MotionTemplate, theta: Theta) -> Row:
    return (*theta, *template.shows_from([theta])[0].tolist())


def _picked_row(pick: Callable[[Row], Row], fixed: Row, theta: Theta) -> Row:
    return pick((*theta, *fixed))
