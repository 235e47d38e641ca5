"""How fast the lookup table is built and asked, beside a k-d tree over the same tuples."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from imolo.method.forward_model import GPR, PAPER_SVR, ForwardModel, ForwardModelConfig
from imolo.method.motion import TRAINING_MOTIONS, Theta
from imolo.method.table import Executed, LookupTable, TableGrid

Array = NDArray[np.float64]

QUERIES = 5000
MODELS = {"svr_paper": PAPER_SVR, "gpr": GPR}


def run() -> dict[str, Any]:
    """Measure on the paper's grid of 549,036 predictions, with a made-up hand in place of a robot.

    Returns:
        For each forward model: `fit` and `build` [s] and the number of `tuples`; for each of `free` (before the onset)
        and `executed` (0.15 s after it): the share of `hits` [-] and the median time of a query of the table and of
        the tree [s], and their `ratio`.
    """
    rng = np.random.default_rng(0)
    result: dict[str, Any] = {}
    for name, config in MODELS.items():
        started = time.perf_counter()
        model = _fitted(config, rng)
        fitted = time.perf_counter()
        table = LookupTable.build(model, TableGrid(), rng)
        built = time.perf_counter()
        result[name] = {
            "fit": fitted - started,
            "build": built - fitted,
            "tuples": len(table),
            "free": _compare(table, None, rng),
            "executed": _compare(table, Executed(Theta(*table.theta[0].tolist()), 0.15), rng),
        }
    return result


def _fitted(config: ForwardModelConfig, rng: np.random.Generator) -> ForwardModel:
    frames = np.arange(0.0, 1.2, 1.0 / 120.0)
    theta = np.repeat(TRAINING_MOTIONS, len(frames), axis=0)
    when = np.tile(frames, len(TRAINING_MOTIONS))
    seen = (when - theta[:, 1] > 0.13) & (when - theta[:, 1] < 0.22)
    theta, when = theta[seen], when[seen]
    return ForwardModel(config).fit(theta, when, _hand(theta, when) + rng.normal(0.0, 0.003, (len(when), 3)))


def _hand(theta: Array, when: Array) -> Array:
    k, t_w = theta.T
    angle = 14.0 * (when - t_w) + 0.3 * k * t_w
    return np.column_stack((1.1 * when + 0.3 * np.sin(angle), 0.35 * k * when, 1.0 + 0.5 * when - 0.4 * np.cos(angle)))


def _compare(table: LookupTable, executed: Executed | None, rng: np.random.Generator) -> dict[str, float]:
    rows = rng.integers(len(table), size=QUERIES)
    positions = table.position[rows] + rng.uniform(-0.004, 0.004, (QUERIES, 3))
    times = (table.time[rows] + rng.uniform(-0.004, 0.004, QUERIES)).tolist()
    tree = cKDTree(table.position)
    reach, tolerance = table.grid.spacing / 2, table.grid.time_tolerance / 2

    def ask_tree(position: Array, when: float, executed: Executed | None) -> object:
        near = tree.query_ball_point(position, reach)
        if not near:
            return None
        distance = np.abs(table.time[near] - when)
        allowed = distance < tolerance
        if executed is not None:
            (k, t_w), elapsed = executed
            new_k, new_t_w = table.theta[near].T
            allowed &= (new_k == k) & ((new_t_w == t_w) | (elapsed <= np.minimum(new_t_w, t_w)))
        return near[int(np.argmin(np.where(allowed, distance, np.inf)))] if allowed.any() else None

    table_time, hits = _median(table.query, positions, times, executed)
    tree_time, tree_hits = _median(ask_tree, positions, times, executed)
    if hits != tree_hits:
        raise RuntimeError(f"the table answered {hits} queries, the tree {tree_hits}")
    return {"hits": hits / QUERIES, "table": table_time, "tree": tree_time, "ratio": tree_time / table_time}


def _median(
    ask: Callable[[Array, float, Executed | None], object],
    positions: Array,
    times: list[float],
    executed: Executed | None,
) -> tuple[float, int]:
    durations, hits = [], 0
    for position, when in zip(positions, times, strict=True):
        started = time.perf_counter_ns()
        answer = ask(position, when, executed)
        durations.append(time.perf_counter_ns() - started)
        hits += answer is not None
    return float(np.median(durations)) * 1e-9, hits


if __name__ == "__main__":
    for name, measured in run().items():
        print(f"{name}: fit {measured['fit']:.2f} s, build {measured['build']:.2f} s, {measured['tuples']} tuples")
        for case in ("free", "executed"):
            row = measured[case]
            print(
                f"  {case}: table {row['table'] * 1e6:.1f} µs, k-d tree {row['tree'] * 1e6:.1f} µs, "
                f"ratio {row['ratio']:.1f}, hits {row['hits']:.0%}"
            )
