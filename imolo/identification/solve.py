"""Find the settings under which an engine repeats the training recordings best, and how surely they are known."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from imolo.errors import IdentificationError
from imolo.identification.evaluation import FAILED, Bench, Outcome
from imolo.identification.experiment import Quantity
from imolo.identification.parameters import Parameter, Settings, from_units, to_units

Array = NDArray[np.float64]

FINE_ENOUGH = 0.01  # of the range: closer than any interval here
FIRST_STEP = 0.2  # of the range: standard deviation of CMA-ES's first generation
SLOPE_STEP = 0.02  # of the range: finite differences of Gauss-Newton, wide against steps of time
DAMPING = (1e-7, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)  # of the mean curvature
SETTLED = 5e-3  # relative gain in the loss below which Gauss-Newton ends
STILL = 1e-3  # of the range: largest move below which it ends as well
TINY = 1e-12
PROBE = 0.05  # of the range: half the distance of finite differences, wide against the jitter of contacts
QUANTILE = 1.645  # of the normal distribution, two-sided 90 %
FLAT = 1e-3  # relative change of the loss over a probe below which a parameter says nothing
TIED = 0.98  # correlation of two parameters' effects above which only one can be told
WIDE = 0.5  # of the range: an interval as wide as this says nothing


@dataclass(frozen=True, eq=False)
class Fit:
    """The best settings found for one engine.

    Attributes:
        settings: By path.
        loss: Mean over the training recordings.
        evaluations: How many sets of settings were played.
        standard_deviation: Of each parameter on the scale of the search, 0 to 1; infinite where nothing is known.
        flags: By path, what is to be said of a value.
    """

    settings: Settings
    loss: float
    evaluations: int
    standard_deviation: dict[str, float] = field(default_factory=dict)
    flags: dict[str, tuple[str, ...]] = field(default_factory=dict)


class Search:
    """The search in one engine: counts, keeps the best, and adds the prior."""

    def __init__(
        self,
        bench: Bench,
        engine: str,
        parameters: Sequence[Parameter],
        indices: Sequence[int],
        budget: int,
        label: str,
        fixed: Settings,
    ) -> None:
        """Prepare a search over the training recordings `indices`, under other settings that are fixed."""
        self._fixed = fixed
        self._budget = budget
        self._bench = bench
        self._engine = engine
        self.parameters = parameters
        self._indices = indices
        self._label = label
        self.count = 0
        self.best: tuple[float, Array] = (np.inf, np.array([p.to_unit(p.start) for p in parameters]))

    def losses(self, many: Sequence[Array]) -> list[float]:
        """Return the loss at each of several places between the bounds, shape (n,) each."""
        return self.judged(many, self.outcomes(many))

    def judged(self, many: Sequence[Array], outcomes: Sequence[Outcome]) -> list[float]:
        """Return the loss at places that were played, and keep the best."""
        values = []
        for units, outcome in zip(many, outcomes, strict=True):
            value = outcome.mean + self.surprise(units)
            values.append(value)
            if value < self.best[0]:
                self.best = (value, np.clip(units, 0.0, 1.0))
        return values

    def outcomes(self, many: Sequence[Array]) -> list[Outcome]:
        """Play the training recordings at several places."""
        self.count += len(many)
        settings = [from_units(self.parameters, units) for units in many]
        return self._bench.play(self._label, self._engine, settings, self._indices, self._fixed, self._budget)

    def surprise(self, units: Array) -> float:
        """Return what the priors add to the mean loss."""
        return float((self.surprises(units) ** 2).sum())

    def surprises(self, units: Array) -> Array:
        """Return what each prior adds, as a residual beside those of the recordings, shape (n,)."""
        settings = from_units(self.parameters, units)
        return np.sqrt([one.surprise(settings[one.path]) / len(self._indices) for one in self.parameters])


def solve(
    bench: Bench,
    engine: str,
    parameters: Sequence[Parameter],
    indices: Sequence[int],
    budget: int,
    seed: int,
    label: str,
    fixed: Settings | None = None,
) -> Fit:
    """Find the best settings of some parameters.

    One parameter is searched by Brent's bounded method, several by CMA-ES, or by Gauss-Newton where the loss is a sum
    of squares.

    Args:
        bench: Plays the recordings.
        engine: Of the backend.
        parameters: What is searched.
        indices: The training recordings.
        budget: How many sets of settings may be played.
        seed: Of CMA-ES.
        label: For the progress.
        fixed: Settings that are not searched and differ from the config's.

    Raises:
        IdentificationError: Nothing could be played.
    """
    search = Search(bench, engine, parameters, indices, budget, label, fixed or {})
    start = search.best[1]
    if search.losses([start])[0] >= FAILED:
        problem = search.outcomes([start])[0].problem
        raise IdentificationError(f"{engine} cannot play any recording where the search starts: {problem}")
    if len(parameters) == 1:
        _brent(search, budget)
    elif bench.experiment.loss == "squared":
        _gauss_newton(search, start, budget)
    else:
        _cma(search, start, budget, seed)
    bench.progress(f"{engine}: {label}", search.count, search.count)
    loss, units = search.best
    return Fit(from_units(parameters, units), loss, search.count)


def _brent(search: Search, budget: int) -> None:
    options = {"xatol": FINE_ENOUGH, "maxiter": max(budget - 1, 1)}
    minimize_scalar(
        lambda unit: search.losses([np.array([unit])])[0], bounds=(0.0, 1.0), method="bounded", options=options
    )


def _cma(search: Search, start: Array, budget: int, seed: int) -> None:
    import cma

    options = {
        "bounds": [0.0, 1.0],
        "seed": seed + 1,  # 0 would be the time
        "maxfevals": budget,
        "tolx": 0.5 * FINE_ENOUGH,
        "tolfun": 1e-6,
        "verbose": -9,
    }
    strategy = cma.CMAEvolutionStrategy(start.tolist(), FIRST_STEP, options)
    while not strategy.stop() and search.count < budget:
        asked = strategy.ask()
        strategy.tell(asked, search.losses([np.array(units) for units in asked]))


def _gauss_newton(search: Search, start: Array, budget: int) -> None:
    """Levenberg and Marquardt's search, which tries several dampings at once, since cores wait for work."""
    sizes = [len(vector) for vector in search.outcomes([start])[0].residual]
    spent = search.count

    def vectors(many: Sequence[Array]) -> list[Array]:
        outcomes = search.outcomes(many)
        search.judged(many, outcomes)
        return [
            np.concatenate((_residual(outcome, sizes), search.surprises(units)))
            for units, outcome in zip(many, outcomes, strict=True)
        ]

    units, here, wide = start, vectors([start])[0], False
    while True:
        widths = np.full(len(units), PROBE if wide else SLOPE_STEP)
        if search.count + (1 + wide) * len(units) + len(DAMPING) > budget and search.count > spent + 1:
            return
        ahead = np.where(units < 0.5, widths, -widths)
        places = [units + step * row for row, step in zip(np.eye(len(units)), ahead, strict=True)]
        behind = [np.clip(2.0 * units - place, 0.0, 1.0) for place in places] if wide else [units] * len(units)
        played = vectors([*places, *behind]) if wide else [*vectors(places), *[here] * len(units)]
        pairs = zip(places, behind, played, played[len(units) :], strict=False)
        slopes = np.stack([(there - back) / float((far - near).sum()) for far, near, there, back in pairs], axis=1)
        gradient = slopes.T @ here
        # What the loss pushes against a bound stays there in this step.
        free = ~(((units <= 0.0) & (gradient > 0.0)) | ((units >= 1.0) & (gradient < 0.0)))
        squares = slopes[:, free].T @ slopes[:, free]
        places = []
        for damping in DAMPING:
            move = np.zeros(len(units))
            stiff = squares + damping * (np.trace(squares) / max(len(squares), 1) + TINY) * np.eye(len(squares))
            move[free] = np.linalg.solve(stiff, -gradient[free])
            places.append(np.clip(units + move, 0.0, 1.0))
        tried = vectors(places)
        best = min(range(len(tried)), key=lambda index: float(tried[index] @ tried[index]))
        gain = 1.0 - float(tried[best] @ tried[best]) / max(float(here @ here), TINY)
        moved = float(np.abs(places[best] - units).max())
        if gain > 0.0:
            units, here = places[best], tried[best]
        if gain < SETTLED or moved < STILL:
            if wide:
                return
            wide = True  # what is left may be the jitter of contacts, which wide differences see less of


def _residual(outcome: Outcome, sizes: Sequence[int]) -> Array:
    """Return one vector of all recordings; those that could not be played count as far off."""
    played = outcome.residual or [np.empty(0)] * len(sizes)
    parts = [
        part if len(part) else np.full(size, np.sqrt(FAILED / max(size, 1)))
        for part, size in zip(played, sizes, strict=True)
    ]
    return np.asarray(np.concatenate(parts) / np.sqrt(len(sizes)))


@dataclass(frozen=True, eq=False)
class Local:
    """How the loss changes around a place.

    Attributes:
        gradient: Of each recording's loss by each parameter, shape (R, n), on the scale of the search.
        hessian: Of the mean loss, shape (n, n).
        swing: Mean change of the recordings' losses over a probe, relative to the mean loss, shape (n,).
        likeness: How alike the effects of each pair of parameters are, over all recordings and quantities: cosine of
            the angle between them, shape (n, n).
        floor: Curvature, relative to the largest one, below which it is noise of the differences.
    """

    gradient: Array
    hessian: Array
    swing: Array
    likeness: Array
    floor: float = 1e-3


def explore(
    bench: Bench,
    engine: str,
    parameters: Sequence[Parameter],
    settings: Settings,
    indices: Sequence[int],
    label: str,
    changes: Settings | None = None,
    pairs: bool = True,
) -> Local:
    """Take slopes and curvatures of the loss around some settings by finite differences.

    Args:
        bench: Plays the recordings.
        engine: Of the backend.
        parameters: What is varied.
        settings: Where.
        indices: Which recordings.
        label: For the progress.
        changes: Settings on top, such as another time step.
        pairs: Whether two parameters are varied at a time as well, for the curvature off the diagonal. Without, one
            that lies at its bound stays there while others are varied, which it may switch off as soon as it moves.
    """
    n = len(parameters)
    exact = to_units(parameters, settings)
    center = np.clip(exact, PROBE, 1.0 - PROBE)
    unit = np.eye(n) * PROBE
    corners = [(i, j) for i in range(n) for j in range(i)] if pairs else []
    places = [center, *(center + unit[i] for i in range(n)), *(center - unit[i] for i in range(n))]
    if not pairs:
        around = np.where(np.eye(n) > 0.0, center, exact)
        places = [exact, *(around + unit), *(around - unit)]
    squared = bench.experiment.loss == "squared"
    if not squared:
        places += [center + unit[i] + unit[j] for i, j in corners]
    played = bench.play(label, engine, [from_units(parameters, place) for place in places], indices, changes)
    loss = np.array([outcome.loss for outcome in played])
    everywhere = np.flatnonzero((loss < FAILED).all(axis=0))
    if not len(everywhere):
        raise IdentificationError(f"{engine} cannot play any recording under all settings tried by {label}")
    loss = loss[:, everywhere]
    middle, up, down = loss[0], loss[1 : n + 1], loss[n + 1 : 2 * n + 1]
    hessian = np.zeros((n, n))
    if squared:
        vectors = [np.concatenate([outcome.residual[index] for index in everywhere.tolist()]) for outcome in played]
        probes = np.array(vectors[1 : 2 * n + 1])
        slopes = (probes[:n] - probes[n:]).T / (2.0 * PROBE)
        hessian = 2.0 * slopes.T @ slopes / len(everywhere)
    else:
        for i in range(n):
            hessian[i, i] = (up[i] + down[i] - 2.0 * middle).mean() / PROBE**2
        for (i, j), corner in zip(corners, loss[2 * n + 1 :], strict=True):
            hessian[i, j] = hessian[j, i] = (corner - up[i] - up[j] + middle).mean() / PROBE**2
    gradient = ((up - down) / (2.0 * PROBE)).T
    swing = np.maximum(np.abs(up - middle), np.abs(down - middle)).mean(axis=1) / max(float(middle.mean()), 1e-12)
    likeness = _correlation(hessian) if squared else _likeness(played, bench.experiment.quantities, n)
    # Products of first differences are exact to rounding, second differences are not.
    return Local(gradient, hessian, swing, likeness, 1e-9 if squared else Local.floor)


def judged(fit: Fit, parameters: Sequence[Parameter], local: Local, halved: Local | None, recordings: int) -> Fit:
    """Return a fit with the standard deviations of its parameters, and what is to be said of them.

    Recordings are taken as independent draws: the covariance is that of an M-estimator, H⁻¹ G H⁻¹ / R, with G the
    covariance of the recordings' slopes. A step of Newton with the slopes at half the time step says how far the
    optimum would move there.
    """
    prior = np.diag([_prior_curvature(one, recordings) for one in parameters])
    hessian = local.hessian + prior
    values, vectors = np.linalg.eigh(hessian)
    known = values > local.floor * max(float(values.max()), 1e-12)
    inverse = (vectors[:, known] / values[known]) @ vectors[:, known].T
    spread = np.atleast_2d(np.cov(local.gradient.T)) / recordings
    covariance = inverse @ (spread + prior / recordings) @ inverse
    lost = (vectors[:, ~known] ** 2).sum(axis=1)
    deviation = np.where(lost > 0.1, np.inf, np.sqrt(np.maximum(np.diag(covariance), 0.0)))
    units = to_units(parameters, fit.settings)
    moved = np.zeros(len(parameters))
    if halved is not None:
        moved = inverse @ (halved.gradient.mean(axis=0) - local.gradient.mean(axis=0))
    flags: dict[str, tuple[str, ...]] = {}
    for index, one in enumerate(parameters):
        said = []
        if units[index] < FINE_ENOUGH or units[index] > 1.0 - FINE_ENOUGH:
            said.append("at its bound")
        if local.swing[index] < FLAT or QUANTILE * deviation[index] > WIDE:
            said.append("not identified")
        for other in range(len(parameters)):
            alone = one.prior is None and parameters[other].prior is None
            if other != index and alone and abs(local.likeness[index, other]) > TIED:
                said.append(f"cannot be told from {parameters[other].path}")
        if halved is not None and abs(moved[index]) > max(QUANTILE * min(deviation[index], 1.0), FINE_ENOUGH):
            said.append("depends on the time step")
        flags[one.path] = tuple(said)
    deviations = {one.path: float(value) for one, value in zip(parameters, deviation, strict=True)}
    return Fit(fit.settings, fit.loss, fit.evaluations, deviations, flags)


def interval(parameter: Parameter, fit: Fit) -> tuple[float, float]:
    """Return the 90 % interval of a parameter, cut off at its bounds."""
    unit, half = parameter.to_unit(fit.settings[parameter.path]), QUANTILE * fit.standard_deviation[parameter.path]
    return parameter.from_unit(max(unit - half, 0.0)), parameter.from_unit(min(unit + half, 1.0))


def _prior_curvature(parameter: Parameter, recordings: int) -> float:
    if parameter.prior is None:
        return 0.0
    step: Callable[[float], float] = lambda unit: parameter.surprise(parameter.from_unit(unit))  # noqa: E731
    middle = parameter.to_unit(min(max(parameter.prior[0], parameter.low), parameter.high))
    middle = min(max(middle, PROBE), 1.0 - PROBE)
    return (step(middle + PROBE) + step(middle - PROBE) - 2.0 * step(middle)) / PROBE**2 / recordings


def _likeness(played: Sequence[Outcome], quantities: Sequence[Quantity], n: int) -> Array:
    effects = []
    for high, low in zip(played[1 : n + 1], played[n + 1 : 2 * n + 1], strict=True):
        changes = [(high.size[one.name] - low.size[one.name]) / one.scale for one in quantities]
        effects.append(np.nan_to_num(np.concatenate(changes)))
    return _correlation(np.array(effects) @ np.array(effects).T)


def _correlation(hessian: Array) -> Array:
    """Return how alike the effects of each pair of parameters are, -1 to 1."""
    size = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    return np.asarray(hessian / np.outer(size, size))
