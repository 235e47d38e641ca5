"""How fast the lookup table is built and asked, beside a k-d tree over the same tuples."""

import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from benchmarks.learned import Learned
from benchmarks.measurement import Measurement
from imolo.method.commands import to_microseconds
from imolo.method.motion import motion_rows
from imolo.method.table import Executed, LookupTable
from imolo.trials.learning import build_table

Array = NDArray[np.float64]
Ask = Callable[[Array, float, Executed], object]

BUILD_TARGETS = {"paper": 0.45, "improved": 1.4}  # [s] at first use
QUERY_TARGETS = {"paper": 2.0, "improved": 2.8}  # [µs]
QUERIES = 5000
ELAPSED = 0.15  # [s] the motion under way is in the middle of its second phase, so that k and t_w must fit


def run(learned: Learned, method: str) -> tuple[list[Measurement], LookupTable]:
    """Build the table of a method from 549,036 predictions, and ask it and a tree the same.

    Raises:
        RuntimeError: The tree answers otherwise.
    """
    started = time.perf_counter()
    # As an experiment does it: one thread.
    with threadpool_limits(limits=1):
        table = build_table(learned.config, learned.config.methods[method], learned.data, learned.ball_models[method])
    elapsed = time.perf_counter() - started
    query, tree = _compare(table)
    subject = f"table, {method}"
    return [
        Measurement(subject, "fit and build", elapsed, "s", BUILD_TARGETS.get(method)),
        Measurement(subject, "query, median", query, "µs", QUERY_TARGETS.get(method)),
        Measurement(subject, "same query of a k-d tree", tree, "µs"),
    ], table


def _compare(table: LookupTable) -> tuple[float, float]:
    rng = np.random.default_rng(0)
    rows = rng.integers(len(table), size=QUERIES)
    positions = table.position[rows] + rng.uniform(-0.004, 0.004, (QUERIES, 3))
    times = (table.time[rows] + rng.uniform(-0.004, 0.004, QUERIES)).tolist()
    executed = [Executed(tuple(theta), ELAPSED) for theta in table.theta[rows].tolist()]
    answers, query = _median(table.query, positions, times, executed)
    same, tree = _median(_tree(table, executed), positions, times, executed)
    if answers != same:
        raise RuntimeError(f"the table answered {answers} queries, the tree {same}")
    return query, tree


def _tree(table: LookupTable, asked: Sequence[Executed]) -> Ask:
    tree = cKDTree(table.position)
    reach, tolerance = table.grid.spacing / 2, table.grid.time_tolerance / 2
    norm = np.inf if table.grid.match == "cell" else 2.0
    count = table.theta.shape[1]
    motions = motion_rows(table.template, table.theta)
    rows = dict(zip(asked, motion_rows(table.template, np.array([one.theta for one in asked])), strict=True))

    def ask(position: Array, when: float, executed: Executed) -> object:
        near = tree.query_ball_point(position, reach, p=norm)
        if not near:
            return None
        distance = np.abs(table.time[near] - when)
        old, new = rows[executed], motions[near]
        same = new[:, :count] == old[:count]
        unseen = to_microseconds(executed.elapsed) <= np.minimum(new[:, count:], old[count:])
        allowed = (distance < tolerance) & (same | unseen).all(axis=1)
        return near[int(np.argmin(np.where(allowed, distance, np.inf)))] if allowed.any() else None

    return ask


def _median(ask: Ask, positions: Array, times: list[float], executed: list[Executed]) -> tuple[int, float]:
    """Return the number of answers and the median time of a query [µs]."""
    durations, answers = [], 0
    for query in zip(positions, times, executed, strict=True):
        started = time.perf_counter_ns()
        answer = ask(*query)
        durations.append(time.perf_counter_ns() - started)
        answers += answer is not None
    return answers, float(np.median(durations)) * 1e-3
