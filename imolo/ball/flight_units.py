"""Units and axes that a file of flights seems to have: a ball in flight falls at g, along the axis that points up."""

from collections.abc import Iterable
from itertools import product

import numpy as np

from imolo.ball.csv_format import LENGTHS, TIMES, Array, CsvFormat
from imolo.ball.flight import FEWEST_SAMPLES, GRAVITY, Flight

AGREEMENT = 2.0  # of accelerations with g: drag and spin of a light ball change it by less, another unit tenfold
ALONG = 0.8  # cosine; half of g across is 0.9


def suspect(tracks: Iterable[Flight], said: CsvFormat) -> str:
    """Return what the flights look like, such as `they fall at g if ...; give --units mm`, or an empty text.

    Args:
        tracks: As they were read with what was said.
        said: What is not doubted.
    """
    accelerations = [_acceleration(track) for track in tracks if len(track.time) >= FEWEST_SAMPLES]
    if not accelerations:
        return ""
    acceleration = np.median(accelerations, axis=0)
    size = float(np.linalg.norm(acceleration))
    axis = int(np.argmax(np.abs(acceleration)))
    if not np.isfinite(size) or size == 0.0 or abs(acceleration[axis]) < ALONG * size:
        return ""
    g = float(np.linalg.norm(GRAVITY))
    lengths = {said.units: 1.0} if said.units else LENGTHS
    times = {said.time: 1.0} if said.time else TIMES
    options = []
    for (length, per_metre), (time, per_second) in product(lengths.items(), times.items()):
        if 1.0 / AGREEMENT < size / per_metre * per_second**2 / g < AGREEMENT:
            options += [f"--units {length}"] if not said.units and length != "m" else []
            options += [f"--time {time}"] if not said.time and time != "s" else []
            break
    else:
        return ""
    if not said.up and (axis != 2 or acceleration[axis] > 0.0):
        options.append(f"--up {'-' if acceleration[axis] > 0.0 else ''}{'xyz'[axis]}")
    if not options:
        return ""
    return f"its balls would fall at {size:.3g} m/s² along {'xyz'[axis]}; it looks like {' '.join(options)}"


def _acceleration(track: Flight) -> Array:
    """Return the median of the second differences over a third of the track [m/s²], shape (3,)."""
    stride = len(track.time) // 6
    before, here, after = (slice(i * stride, len(track.time) - (2 - i) * stride) for i in range(3))
    time, position = track.time, track.position
    earlier = (position[here] - position[before]) / (time[here] - time[before])[:, np.newaxis]
    later = (position[after] - position[here]) / (time[after] - time[here])[:, np.newaxis]
    change: Array = 2.0 * (later - earlier) / (time[after] - time[before])[:, np.newaxis]
    return np.asarray(np.median(change, axis=0))
