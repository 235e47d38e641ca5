"""Claims about the lookup table: what it keeps and what it answers."""

from itertools import pairwise
from typing import Literal

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError
from rough_tables import ROUGH, SHARP, TABLE, rough_table

from imolo.errors import ConfigError, NotTrainedError
from imolo.method.forward_model import ForwardModel
from imolo.method.motion import MotionTemplate, Theta
from imolo.method.table import Executed, GridAxis, LookupTable, TableGrid
from imolo.method.table_kernel import keeps_executed_part

Array = NDArray[np.float64]

ONSET = 7_000_000  # [µs]


def brute_force(table: LookupTable, path: Array, when: Array, executed: Executed | None) -> tuple[int, int] | None:
    """Sec. IV-A and Fig. 4(c-e) as they are written, tuple by tuple."""
    commands = [table.template.commands(Theta(*theta), ONSET) for theta in table.theta.tolist()]
    for point, (position, time) in enumerate(zip(path, when, strict=True)):
        near = np.linalg.norm(table.position - position, axis=1) < table.grid.spacing / 2
        distance = np.abs(table.time - time)
        rows = np.flatnonzero(near & (distance < table.grid.time_tolerance / 2))
        if executed is not None:
            old = table.template.commands(executed.theta, ONSET)
            now = ONSET + round(executed.elapsed * 1e6)
            rows = np.array([row for row in rows if commands[row].matches_until(old, now)], dtype=int)
        if len(rows):
            return point, int(rows[np.argmin(distance[rows])])
    return None


def test_grid_of_the_paper_has_its_549036_predictions() -> None:
    grid = TableGrid()
    assert [len(axis.values()) for axis in (grid.t_w, grid.k, grid.time_since_swing)] == [101, 151, 36]
    assert grid.k.values()[-1] == 0.995
    theta, time = grid.predictions()
    assert len(theta) == len(time) == 549_036
    np.testing.assert_allclose(np.ptp(time - theta[:, 1]), 0.07, atol=1e-9)


@settings(deadline=None)
@given(point=st.tuples(*[st.floats(-5.0, 5.0)] * 3))
def test_nearest_grid_point_is_within_half_a_cell(point: tuple[float, float, float]) -> None:
    positions = np.array([point])

    class Still(ForwardModel):
        def predict(self, theta: object, time: object) -> Array:
            return positions.repeat(len(np.asarray(time)), axis=0)

    one = GridAxis(start=0.3, stop=0.3, step=1.0)
    grid = TableGrid(t_w=one, k=GridAxis(start=0.0, stop=0.0, step=1.0), time_since_swing=one)
    still = Still().fit(SHARP.training.theta, SHARP.training.time, SHARP.training.position)
    table = LookupTable.build(still, grid, np.random.default_rng(0))
    assert len(table) == 1
    assert np.abs(table.position[0] - point).max() <= 0.005 + 1e-12
    np.testing.assert_allclose(table.position / 0.010, np.rint(table.position / 0.010), atol=1e-9)


def test_paper_keeps_one_tuple_of_each_grid_point() -> None:
    everything, voxels, moments = rough_table("all"), rough_table("voxel"), rough_table("voxel_time")
    assert len(everything) == 21 * 17 * 8
    occupied = np.unique(everything.position, axis=0)
    np.testing.assert_array_equal(np.unique(voxels.position, axis=0), occupied)
    assert len(voxels) == len(occupied)
    wanted = np.unique(np.column_stack((everything.position, np.rint(everything.time * 1e6))), axis=0)
    assert len(moments) == len(wanted)
    np.testing.assert_array_equal(
        np.unique(np.column_stack((moments.position, np.rint(moments.time * 1e6))), axis=0), wanted
    )


@pytest.mark.parametrize("unique", ["voxel", "voxel_time"])
def test_choice_among_equals_is_random_but_seeded(unique: Literal["voxel", "voxel_time"]) -> None:
    first, same, other = rough_table(unique, seed=1), rough_table(unique, seed=1), rough_table(unique, seed=2)
    np.testing.assert_array_equal(first.theta, same.theta)
    assert (first.theta != other.theta).any()


def test_every_tuple_is_a_prediction_of_the_model() -> None:
    predicted = SHARP.predict(TABLE.theta, TABLE.time)
    assert np.abs(predicted - TABLE.position).max() <= ROUGH.spacing / 2 + 1e-12


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    length=st.integers(1, 8),
    spread=st.sampled_from([0.0, 0.004, 0.02, 3.0]),
    elapsed=st.none() | st.sampled_from([-0.1, 0.0, 1e-6, 0.1, 0.25, 0.3, 0.300001]) | st.floats(-0.1, 0.5),
)
def test_query_finds_what_a_search_of_all_tuples_finds(
    seed: int, length: int, spread: float, elapsed: float | None
) -> None:
    rng = np.random.default_rng(seed)
    rows = rng.integers(len(TABLE), size=length)
    path = TABLE.position[rows] + rng.normal(0.0, spread, (length, 3))
    when = TABLE.time[rows] + rng.normal(0.0, 0.01, length)
    executed = None if elapsed is None else Executed(Theta(*TABLE.theta[rng.choice(rows)].tolist()), elapsed)
    expected = brute_force(TABLE, path, when, executed)
    hit = TABLE.query_path(path, when, executed)
    assert (hit and (hit.path_index, hit.tuple_index)) == expected
    singles = (TABLE.query(position, time, executed) for position, time in zip(path, when, strict=True))
    first = next((single for single in singles if single is not None), None)
    assert (first and first.tuple_index) == (hit and hit.tuple_index)
    if hit is not None:
        assert hit.theta == tuple(TABLE.theta[hit.tuple_index])
        assert hit.time == TABLE.time[hit.tuple_index]
        np.testing.assert_array_equal(hit.position, TABLE.position[hit.tuple_index])


TEMPLATES = [
    MotionTemplate(),
    MotionTemplate(changed_phase=2),
    MotionTemplate(changed_phase=3),
    MotionTemplate(switch_phase=1, fixed_switch_time=(0.5, 1.2)),
    MotionTemplate(switch_phase=1, changed_phase=2, fixed_switch_time=(0.5, 1.2)),
]


@settings(deadline=None)
@given(
    template=st.sampled_from(TEMPLATES),
    thetas=st.tuples(*[st.builds(Theta, k=st.integers(-4, 4).map(lambda n: n / 4), t_w=st.floats(0.11, 0.45))] * 2),
    same=st.tuples(st.booleans(), st.booleans()),
    near=st.sampled_from([None, 0, 1, 2, 3]),
    offset=st.integers(-1, 1),
    free=st.integers(-100, 1_400_000),
)
@example(TEMPLATES[0], (Theta(0.5, 0.30), Theta(0.5, 0.25)), (True, False), 3, 0, 0)  # the new one switches now
@example(TEMPLATES[0], (Theta(0.5, 0.25), Theta(0.5, 0.30)), (True, False), 2, 0, 0)  # the old one would switch now
@example(TEMPLATES[0], (Theta(0.5, 0.25), Theta(0.0, 0.25)), (False, True), 0, 0, 0)  # the motion starts now
def test_fast_condition_says_what_the_commands_say(
    template: MotionTemplate,
    thetas: tuple[Theta, Theta],
    same: tuple[bool, bool],
    near: int | None,
    offset: int,
    free: int,
) -> None:
    old, new = thetas
    new = Theta(old.k if same[0] else new.k, old.t_w if same[1] else new.t_w)
    switches = [template.commands(theta, 0).switch_utime for theta in (old, new)]
    elapsed = (
        free if near is None else [0, switches[0][0], switches[0][1], switches[1][template.switch_phase - 1]][near]
    )
    elapsed += offset
    begun = elapsed > round(template.changed_phase_start(old.t_w) * 1e6)
    fast = keeps_executed_part(
        new.k,
        float(round(new.t_w * 1e6)),
        old.k if begun else float("nan"),
        float(round(old.t_w * 1e6)),
        float(elapsed),
    )
    commands = [template.commands(theta, ONSET) for theta in (new, old)]
    assert fast == commands[0].matches_until(commands[1], ONSET + elapsed)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_impossible_query_has_no_answer(value: float) -> None:
    for axis in range(3):
        position = TABLE.position[0].copy()
        position[axis] = value
        assert TABLE.query(position, TABLE.time[0].item()) is None
    assert TABLE.query(TABLE.position[0], value) is None
    assert TABLE.query(TABLE.position[0], TABLE.time[0].item()) is not None


def test_bounds_of_space_and_time_are_excluded() -> None:
    grid = ROUGH.model_copy(update={"spacing": 0.25, "time_tolerance": 0.25})  # halves are exact in binary
    table = LookupTable.build(SHARP, grid, np.random.default_rng(0))
    up = np.array([0.0, 0.0, 1.0])
    for side, row in ((1.0, int(table.position[:, 2].argmax())), (-1.0, int(table.position[:, 2].argmin()))):
        position, time = table.position[row], table.time[row].item()  # nothing lies beyond it on this side
        assert table.query(position + side * 0.1249 * up, time) is not None
        assert table.query(position + side * 0.125 * up, time) is None
    instant = table.grid.model_copy(update={"k": GridAxis(start=0.0, stop=0.0, step=1.0)})
    half_second = GridAxis(start=0.25, stop=0.25, step=1.0)
    instant = instant.model_copy(update={"t_w": half_second, "time_since_swing": half_second})
    single = LookupTable.build(SHARP, instant, np.random.default_rng(0))
    for side in (1.0, -1.0):
        assert single.query(single.position[0], 0.5 + side * 0.1249) is not None
        assert single.query(single.position[0], 0.5 + side * 0.125) is None


def test_path_and_times_of_other_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="give"):
        TABLE.query_path(np.zeros((2, 3)), np.zeros(3))
    with pytest.raises(ValueError, match="give"):
        TABLE.query((0.0, 0.0), 0.0)


def test_views_of_other_memory_layouts_are_answered_alike() -> None:
    path = np.asfortranarray(TABLE.position[:9])
    hit = TABLE.query_path(path[::2], TABLE.time[:9][::2])
    assert hit is not None
    assert hit.path_index == 0


def test_table_cannot_be_changed_from_outside() -> None:
    for array in (TABLE.position, TABLE.time, TABLE.theta):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


def test_unfitted_model_builds_no_table() -> None:
    with pytest.raises(NotTrainedError):
        LookupTable.build(ForwardModel(), ROUGH, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"k": GridAxis(start=0.0, stop=1.5, step=0.5)}, "k is 1.5"),
        ({"t_w": GridAxis(start=0.1, stop=0.3, step=0.1)}, "t_w is 0.1"),
        ({"spacing": 1e-5}, "give a spacing above 1e-05 m"),
    ],
)
def test_grid_that_cannot_be_built_is_named(change: dict[str, object], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        LookupTable.build(SHARP, ROUGH.model_copy(update=change), np.random.default_rng(0))


def test_grid_without_values_is_refused() -> None:
    for change in ({"start": 1.0, "stop": 0.0, "step": 1.0}, {"start": 0.0, "stop": 1.0, "step": 0.0}):
        with pytest.raises(ValidationError):
            GridAxis.model_validate(change)


def test_tuples_are_in_the_order_of_their_grid_points() -> None:
    index = np.rint(TABLE.position / ROUGH.spacing).astype(int)
    assert all(tuple(a) <= tuple(b) for a, b in pairwise(index))
