"""Claims about the lookup table: what it keeps and what it answers."""

from itertools import pairwise
from typing import Literal

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from liberobot import GRID, MOTION
from made_up_motions import MADE_UP, OF_THE_PAPER, thetas
from numpy.typing import NDArray
from pydantic import ValidationError
from rough_tables import ROUGH, SHARP, TABLE, rough_table

from imolo.errors import ConfigError, NotTrainedError
from imolo.method.forward_model import PAPER_SVR, ForwardModel
from imolo.method.motion import MotionTemplate, PhasedMotion, Theta, motion_rows
from imolo.method.table import Executed, LookupTable
from imolo.method.table_grid import GridAxis, TableGrid
from imolo.method.table_kernel import keeps_executed_part

Array = NDArray[np.float64]

ONSET = 7_000_000  # [µs]


def brute_force(table: LookupTable, path: Array, when: Array, executed: Executed | None) -> tuple[int, int] | None:
    """Sec. IV-A and Fig. 4(c-e) as they are written, tuple by tuple."""
    commands = [table.template.commands(theta, ONSET) for theta in table.theta.tolist()]
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
    t_w, k = GRID.parameters["t_w"], GRID.parameters["k"]
    assert [len(axis.values()) for axis in (t_w, k, GRID.time_since_swing)] == [101, 151, 36]
    assert k.values()[-1] == 0.995
    theta, time = GRID.predictions(MOTION)
    assert len(theta) == len(time) == 549_036
    np.testing.assert_allclose(np.ptp(time - theta[:, 1]), 0.07, atol=1e-9)


class Still(ForwardModel):
    """Predicts that the hand is at one point."""

    point = (0.0, 0.0, 0.0)

    def predict(self, theta: object, time: object) -> Array:
        return np.array([self.point]).repeat(len(np.asarray(time)), axis=0)

    def refitted(self, *_: object) -> "Still":
        return self


@pytest.fixture(scope="module")
def still() -> Still:
    model = Still(PAPER_SVR, MOTION)
    model.fit(SHARP.training.theta, SHARP.training.time, SHARP.training.position)
    return model


@given(point=st.tuples(*[st.floats(-5.0, 5.0)] * 3))
def test_nearest_grid_point_is_within_half_a_cell(still: Still, point: tuple[float, float, float]) -> None:
    still.point = point
    one = GridAxis(start=0.3, stop=0.3, step=1.0)
    grid = TableGrid(parameters={"t_w": one, "k": GridAxis(start=0.0, stop=0.0, step=1.0)}, time_since_swing=one)
    table = LookupTable.build(still, grid, np.random.default_rng(0), robot="testbot")
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
    executed = None if elapsed is None else Executed(tuple(TABLE.theta[rng.choice(rows)].tolist()), elapsed)
    expected = brute_force(TABLE, path, when, executed)
    hit = TABLE.query_path(path, when, executed)
    assert (hit and (hit.path_index, hit.tuple_index)) == expected
    singles = (TABLE.query(position, time, executed) for position, time in zip(path, when, strict=True))
    first = next((single for single in singles if single is not None), None)
    assert (first and first.tuple_index) == (hit and hit.tuple_index)
    if hit is not None:
        assert hit.theta == tuple(TABLE.theta[hit.tuple_index])
        assert hit.time == TABLE.time[hit.tuple_index]


@pytest.mark.parametrize("late", [-0.5, -0.25, 0.0, 0.25, 0.5, 0.5 + 1e-9])
def test_full_cells_answer_at_the_edges_of_the_tolerance(late: float) -> None:
    tolerance = ROUGH.time_tolerance
    # Times at multiples of a quarter of Δt, from before the onset on: at the edges of every division in time.
    quarters = np.arange(-9, 160)
    time = np.append(quarters * 0.25 * tolerance, (0.0, 3.0))
    theta = np.random.default_rng(0).choice(TABLE.theta, len(time))
    table = LookupTable(
        np.repeat([[4, 5, 6]], len(time), axis=0),
        time,
        theta,
        TABLE.hand_std,
        grid=ROUGH,
        template=TABLE.template,
        forward_model=TABLE.forward_model,
        training=TABLE.training,
        robot="testbot",
        origin={},
    )
    for at in (*time[::7], -1.0, -3.0 * tolerance, 2.99, 3.01, np.inf, -np.inf, np.nan):
        when = np.array([at + late * tolerance])
        executed = Executed(tuple(table.theta[3].tolist()), 0.26)
        for asked in (None, executed):
            hit = table.query_path(table.position[:1], when, asked)
            expected = brute_force(table, table.position[:1], when, asked)
            assert (hit and (hit.path_index, hit.tuple_index)) == expected
    np.testing.assert_array_equal(table.times_at(table.position[0]), np.sort(time))


def test_whole_numbers_are_asked_for_like_others() -> None:
    asked = (TABLE.position[0].tolist(), TABLE.time[0].item())
    hits = [TABLE.query(*asked, Executed(theta, -1.0)) for theta in ((0, 0.3), (0.0, 0.3))]
    assert hits[0] is not None
    assert hits[0] == hits[1]


def instants(template: PhasedMotion, theta: Theta) -> list[int]:
    """Return onset and ends of the phases since the onset [µs]."""
    return [0, *template.commands(theta, 0).switch_utime]


@st.composite
def two_motions(draw: st.DrawFn) -> tuple[PhasedMotion, Theta, Theta, int]:
    """Draw a template, two motions that share some parameters, and a time, often within a microsecond of a switch."""
    template = draw(st.sampled_from(OF_THE_PAPER + MADE_UP))
    old, other = draw(thetas(template)), draw(thetas(template))
    shared = draw(st.tuples(*[st.booleans()] * len(old)))
    new = tuple(a if same else b for a, b, same in zip(old, other, shared, strict=True))
    switches = instants(template, old) + instants(template, new)
    near = st.sampled_from(switches).flatmap(lambda at: st.integers(at - 1, at + 1))
    return template, old, new, draw(near | st.integers(-100, 1_400_000))


@settings(deadline=None, max_examples=500)
@given(two_motions())
@example((MOTION, (0.5, 0.30), (0.5, 0.25), 250_000))  # the new one switches now
@example((MOTION, (0.5, 0.25), (0.5, 0.30), 250_000))  # the old one would switch now
@example((MOTION, (0.5, 0.25), (0.0, 0.25), 0))  # the motion starts now
def test_fast_condition_says_what_the_commands_say(drawn: tuple[PhasedMotion, Theta, Theta, int]) -> None:
    template, old, new, elapsed = drawn
    rows = motion_rows(template, np.array([old, new]))
    row = template.row_maker()(old)
    np.testing.assert_array_equal(row, MotionTemplate.row_maker(template)(old))
    fast = keeps_executed_part(rows, 1, 0, row, elapsed * 1e-6)
    commands = [template.commands(theta, ONSET) for theta in (new, old)]
    assert fast == commands[0].matches_until(commands[1], ONSET + elapsed)


def lattice_of(template: PhasedMotion, values: int) -> TableGrid:
    """Return a grid of some values of each parameter, and two times of the swing."""
    axes = {}
    for one in template.varied:
        low, high = template.bounds(one)
        step = round((high - low) / (values + 1), 3)
        axes[one.name] = GridAxis(start=low + step, stop=low + values * step, step=step)
    return TableGrid(parameters=axes, time_since_swing=GridAxis(start=0.02, stop=0.04, step=0.02), unique="all")


@pytest.mark.parametrize("template", MADE_UP, ids=lambda template: "_".join(one.name for one in template.varied))
def test_table_of_any_number_of_parameters_answers_as_a_search_of_all_tuples(template: PhasedMotion) -> None:
    class Sum(ForwardModel):
        def predict(self, theta: object, time: object) -> Array:
            # Many motions share a grid point, so that the executed part decides.
            return np.repeat(np.round(np.sum(theta, axis=1) * 10.0)[:, np.newaxis] / 100.0, 3, axis=1)

    grid = lattice_of(template, 3)
    theta, time = grid.predictions(template)
    model = Sum(PAPER_SVR, template).fit(theta, time, np.zeros((len(time), 3)))
    table = LookupTable.build(model, grid, np.random.default_rng(0), robot="testbot")
    assert len(table) == 2 * 3 ** len(template.varied)
    assert sorted(map(tuple, table.theta.tolist())) == sorted(map(tuple, theta.tolist()))
    for row in range(0, len(table), 5):
        old = tuple(table.theta[row].tolist())
        for elapsed in (-0.01, *(at * 1e-6 + late for at in instants(template, old) for late in (0.0, 1e-6))):
            path, when = table.position[[row]], table.time[[row]]
            executed = Executed(old, elapsed)
            hit = table.query_path(path, when, executed)
            expected = brute_force(table, path, when, executed)
            assert (hit and (hit.path_index, hit.tuple_index)) == expected


def test_grid_over_other_parameters_than_the_motions_is_named() -> None:
    with pytest.raises(ConfigError, match=r"the grid is over t_w, k, the motion has t, k, m; give each an axis"):
        ROUGH.predictions(MADE_UP[2])


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
    table = LookupTable.build(SHARP, grid, np.random.default_rng(0), robot="testbot")
    up = np.array([0.0, 0.0, 1.0])
    for side, row in ((1.0, int(table.position[:, 2].argmax())), (-1.0, int(table.position[:, 2].argmin()))):
        position, time = table.position[row], table.time[row].item()  # nothing lies beyond it on this side
        assert table.query(position + side * 0.1249 * up, time) is not None
        assert table.query(position + side * 0.125 * up, time) is None
    quarter_second = GridAxis(start=0.25, stop=0.25, step=1.0)
    axes = {"k": GridAxis(start=0.0, stop=0.0, step=1.0), "t_w": quarter_second}
    instant = table.grid.model_copy(update={"parameters": axes, "time_since_swing": quarter_second})
    single = LookupTable.build(SHARP, instant, np.random.default_rng(0), robot="testbot")
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
        LookupTable.build(ForwardModel(PAPER_SVR, MOTION), ROUGH, np.random.default_rng(0), robot="testbot")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"parameters": {**ROUGH.parameters, "k": GridAxis(start=0.0, stop=1.5, step=0.5)}}, "k is 1.5"),
        ({"parameters": {**ROUGH.parameters, "t_w": GridAxis(start=0.1, stop=0.3, step=0.1)}}, "t_w is 0.1"),
        ({"spacing": 1e-5}, "give a spacing above 1e-05 m"),
    ],
)
def test_grid_that_cannot_be_built_is_named(change: dict[str, object], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        LookupTable.build(SHARP, ROUGH.model_copy(update=change), np.random.default_rng(0), robot="testbot")


def test_grid_without_values_is_refused() -> None:
    for change in ({"start": 1.0, "stop": 0.0, "step": 1.0}, {"start": 0.0, "stop": 1.0, "step": 0.0}):
        with pytest.raises(ValidationError):
            GridAxis.model_validate(change)


def test_tuples_are_in_the_order_of_their_grid_points() -> None:
    index = np.rint(TABLE.position / ROUGH.spacing).astype(int)
    assert all(tuple(a) <= tuple(b) for a, b in pairwise(index))
