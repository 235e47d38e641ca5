"""Fields of a log over time, in memory that does not depend on the length of the log."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imolo.errors import FieldError
from imolo.inspect import fields
from imolo.inspect.fields import Selector, leaf_name, leaf_unit, selected
from imolo.inspect.names import Names
from imolo.inspect.trials import Heard, Timeline, TrialEvents
from imolo.messaging.channels import CHANNELS, TRIAL
from imolo.messaging.log_file import LogReader

Array = NDArray[np.float64]
Thin = Callable[[Array], Array]

NUMBERS = 1 << 18  # that are kept of one field; a longer series is thinned to half of it and more


@dataclass(frozen=True)
class Series:
    """Numbers over time.

    Attributes:
        time: Time of the messages since the start of the first trial [s], shape (N,).
        values: Shape (N, K); NaN where a message has no such element, and between two trials.
        labels: What each of the K columns is.
        units: Of each of the columns; empty where it is not known.
        backend: Whose run it is; empty where the log does not say it.
    """

    time: Array
    values: Array
    labels: tuple[str, ...]
    units: tuple[str, ...] = ()
    backend: str = ""

    @property
    def unit(self) -> str:
        """The unit that all columns have in common; empty where they have none."""
        return self.units[0] if len(set(self.units)) == 1 else ""


def envelope(rows: Array) -> Array:
    """Return smallest and largest number of each column, so that a plot keeps its outline; shape (2, K)."""
    return np.array([np.fmin.reduce(rows), np.fmax.reduce(rows)])


def samples(rows: Array) -> Array:
    """Return rows as they are, spread evenly; shape (2, K)."""
    return rows[:: len(rows) // 2]


def read_series(
    path: Path,
    selectors: Sequence[Selector],
    trial: int | None = None,
    *,
    only_one: bool = False,
    required: bool = True,
    thin: Thin = envelope,
    quiet: bool = False,
) -> list[Series]:
    """Read some fields of a log.

    Args:
        path: Of the log.
        selectors: What to read.
        trial: Which trial, from 0; None for all, one after the other.
        only_one: Refuse a log of several trials where none is chosen.
        required: Refuse a log in which a channel is silent; otherwise its series is empty.
        thin: Makes two rows of several, shape (2n, K) to (2, K), where a series is too long.
        quiet: Do not warn of what is wrong with the log.

    Raises:
        BusError: The log cannot be read, or has no such trial.
        FieldError: A channel is silent.
    """
    wanted = {selector.channel for selector in selectors}
    collected = [_Collector(selector, thin) for selector in selectors]
    with LogReader(path, wanted | {TRIAL}, quiet) as reader:
        timeline = Timeline(TrialEvents(reader, trial, only_one), wanted)
        for heard in timeline:
            for collector in collected:
                collector.add(heard)
    names = Names.of(path)
    backend = timeline.events.start.backend if timeline.events.start is not None else ""
    found = [replace(collector.finish(timeline.origin, names), backend=backend) for collector in collected]
    for selector, series in zip(selectors, found, strict=True):
        if required and not len(series.time):
            heard_of = ", ".join(name for name in CHANNELS if name in timeline.events.heard)
            raise FieldError(f"{path} has no {selector.channel}; it has {heard_of or 'no message of ours'}")
    return found


class _Collector:
    """Collects one field as its messages come."""

    def __init__(self, selector: Selector, thin: Thin) -> None:
        self._selector, self._thin = selector, thin
        self._columns: dict[fields.Path, int] = {}
        self._rows: list[list[float]] = []  # time and values
        self._bucket: list[list[float]] = []  # rows of which two will be kept
        self._bucket_size = 1
        self._trial = -1

    def add(self, heard: Heard) -> None:
        if heard.event.channel != self._selector.channel:
            return
        if self._rows and heard.trial != self._trial:
            self._keep([float(heard.time)])  # the line is broken between two trials
        self._trial = heard.trial
        row = [float(heard.time)] + [np.nan] * len(self._columns)
        for path, value in selected(heard.message, self._selector.steps):
            column = self._columns.setdefault(path, len(self._columns))
            if column + 1 < len(row):
                row[column + 1] = float(value)
            else:
                row.append(float(value))
        self._keep(row)

    def finish(self, origin: int, names: Names) -> Series:
        """Return the series, its time counted from `origin` [µs]."""
        rows = self._array([*self._rows, *self._bucket]).reshape(-1, len(self._columns) + 1)
        channel = self._selector.channel
        labels = tuple(f"{channel}.{leaf_name(channel, path, names)}" for path in self._columns)
        units = tuple(leaf_unit(channel, path, names) for path in self._columns)
        return Series((rows[:, 0] - origin) * 1e-6, rows[:, 1:], labels, units)

    def _keep(self, row: list[float]) -> None:
        self._bucket.append(row)
        if len(self._bucket) < self._bucket_size:
            return
        self._rows.extend(self._bucket if self._bucket_size == 1 else self._thin(self._array(self._bucket)).tolist())
        self._bucket = []
        if len(self._rows) * (len(self._columns) + 1) > NUMBERS:
            rows = self._array(self._rows)
            thinned = [self._thin(rows[start : start + 4]) for start in range(0, len(rows) - 3, 4)]
            self._rows = [*np.concatenate(thinned).tolist(), *self._rows[len(rows) // 4 * 4 :]]
            self._bucket_size = max(4, 2 * self._bucket_size)

    def _array(self, rows: list[list[float]]) -> Array:
        """Return rows, which may be shorter than the newest one, with NaN where they end."""
        width = len(self._columns) + 1
        return np.array([row + [np.nan] * (width - len(row)) for row in rows], dtype=np.float64)
