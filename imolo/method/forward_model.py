"""The forward model s = f(theta, t) (Eq. 2): nonlinear interpolation between the trials (Sec. IV-B1)."""

from dataclasses import dataclass
from inspect import signature
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, JsonValue, model_validator

from imolo.config.model import Model
from imolo.errors import ConfigError, NotTrainedError, TrainingDataError
from imolo.method.motion import MotionTemplate
from imolo.method.regressors import (
    PROCESS,
    KernelSum,
    chunks,
    fit_quietly,
    kernel_sum,
    make_regressor,
    one_thread,
    set_noise,
)

Array = NDArray[np.float64]

# The search for a kernel takes the cube of their number: some seconds for these, a minute for twice as many.
SEARCHED_SAMPLES = 600


@dataclass(frozen=True, eq=False)
class TrainingData:
    """The tuples (s, t, theta) of the trials (Sec. IV-A), copied and read-only.

    Attributes:
        theta: Motion parameters, shape (N, n).
        time: Time since motion onset [s], shape (N,).
        position: Hand positions in the world frame [m], shape (N, 3).

    Raises:
        TrainingDataError: There are no samples, the shapes disagree, or a value is not finite.
    """

    theta: Array
    time: Array
    position: Array

    def __post_init__(self) -> None:
        for name, width in (("theta", ("n",)), ("time", ()), ("position", (3,))):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.flags.writeable = False
            object.__setattr__(self, name, array)
            if array.ndim != len(width) + 1 or (width == (3,) and array.shape[1] != 3):
                raise TrainingDataError(f"{name} has shape {array.shape}; give {('N', *width)}".replace("'", ""))
            if len(array) != len(self.theta):
                raise TrainingDataError(
                    f"{name} has {len(array)} samples, theta {len(self.theta)}; give as many of both"
                )
            if not np.isfinite(array).all():
                row = np.argwhere(~np.isfinite(array))[0, 0]
                raise TrainingDataError(
                    f"{name} of sample {row} is {array[row]}; leave out samples that are not finite"
                )
        if len(self.theta) == 0:
            raise TrainingDataError(
                "there are no training samples; record trials that reach the sampled time of the swing"
            )

    def thinned(self, most: int) -> "TrainingData":
        """Return every second sample, or every third and so on, so that there are at most this many."""
        kept = slice(None, None, -(-len(self.time) // most))
        return TrainingData(self.theta[kept], self.time[kept], self.position[kept])


class ForwardModelConfig(Model):
    """Which regression approximates f and what it is fed; `PAPER_SVR`, `GPR` and `MLP` are ready-made.

    Attributes:
        estimator: Class name of a scikit-learn regressor.
        parameters: Arguments of its constructor; the others keep scikit-learn's defaults. Where another estimator than
            SVR is named, none are given.
        inputs: Feed theta and time [s] as they are, or with zero mean and unit variance over the samples.
        outputs: The same for the positions [m].
        time: Last input: the time since the onset as in Eq. 2, or since the start of the swing, t - t_w.
        kernel: Of a Gaussian process: infinitely smooth, or once differentiable (Matérn 3/2), which claims to know less
            between the trials.
        prior: Table file learned on another body; the regression then learns by which the samples differ from what
            that predicts. See docs/transfer.md.
    """

    estimator: str = "SVR"
    parameters: dict[str, JsonValue] = Field({"C": 0.1427, "epsilon": 0.0143, "gamma": 1.0})
    inputs: Literal["raw", "standardized"] = "raw"
    outputs: Literal["raw", "standardized"] = "raw"
    time: Literal["since_onset", "since_swing"] = "since_onset"
    kernel: Literal["rbf", "matern"] = "rbf"
    prior: str | None = None

    @model_validator(mode="before")
    @classmethod
    def _leave_the_paper_its_parameters(cls, values: Any) -> Any:
        if isinstance(values, dict) and values.get("estimator", "SVR") != "SVR":
            return {"parameters": {}, **values}
        return values


PAPER_SVR = ForwardModelConfig()
"""Support vector regression with the constants of Sec. VI: C = 0.1427, epsilon = 0.0143, kernel width 1.0.

Our reading: C and epsilon have the ratio 10 of iqr(Y) / 1.349 and iqr(Y) / 13.49, the defaults of MATLAB's fitrsvm
with KernelScale 1. So they belong to raw inputs and to outputs in metres, where epsilon is 14.3 mm.
"""

GPR = ForwardModelConfig(
    estimator="GaussianProcessRegressor",
    parameters={"n_restarts_optimizer": 2, "random_state": 0},
    inputs="standardized",
    outputs="standardized",
)
"""Gaussian process regression [20], ours: one length scale for each input, common to the three coordinates."""

MLP = ForwardModelConfig(
    estimator="MLPRegressor",
    parameters={
        "hidden_layer_sizes": [16, 16],
        "activation": "tanh",
        "solver": "lbfgs",
        "alpha": 0.01,
        "max_iter": 2000,
        "random_state": 0,
    },
    inputs="standardized",
    outputs="standardized",
)
"""A computational neural network [19], ours: small, as the samples are few."""


@dataclass(frozen=True)
class _Scaling:
    mean: Array
    spread: Array

    @classmethod
    def of(cls, values: Array, mode: str) -> Self:
        if mode == "raw":
            return cls(np.zeros(values.shape[1]), np.ones(values.shape[1]))
        spread = values.std(axis=0)
        return cls(values.mean(axis=0), np.where(spread > 0.0, spread, 1.0))

    def apply(self, values: Array) -> Array:
        return (values - self.mean) / self.spread


class ForwardModel:
    """Predicts where the hand is from the motion parameter and the time (Eq. 2).

    With a prior, s = prior(theta, t) + r(theta, t): the regression learns r, by which the samples differ from it.
    """

    def __init__(
        self, config: ForwardModelConfig, template: MotionTemplate, prior: "ForwardModel | None" = None
    ) -> None:
        """Create an unfitted model.

        Args:
            config: Which regression.
            template: Whose theta it is.
            prior: A fitted model of another body, such as an engine, that moves nearly alike.

        Raises:
            ConfigError: The estimator or one of its parameters is unknown, or the prior of the config is not given.
        """
        if config.prior is not None and prior is None:
            raise ConfigError(f"the model is to correct the prior {config.prior}; use `prior.fit_forward_model`")
        self.config = config
        self.template = template
        self.prior = prior
        self._unfitted = make_regressor(
            config.estimator, config.parameters, num_inputs=len(template.parameters) + 1, kernel=config.kernel
        )
        self._training: TrainingData | None = None
        self._regressor: Any
        self._input_scaling: _Scaling
        self._output_scaling: _Scaling
        self._kernel_sum: KernelSum | None = None

    @property
    def training(self) -> TrainingData:
        """What the model was fitted to.

        Raises:
            NotTrainedError: `fit` has not been called.
        """
        if self._training is None:
            raise NotTrainedError(f"the {self.config.estimator} model has not been fitted; call fit first")
        return self._training

    def fit(self, theta: ArrayLike, time: ArrayLike, position: ArrayLike) -> Self:
        """Learn from the samples of the trials.

        Args:
            theta: Motion parameters, shape (N, n).
            time: Time since motion onset [s], shape (N,).
            position: Hand positions in the world frame [m], shape (N, 3).

        Raises:
            TrainingDataError: There are no samples, the shapes disagree, or a value is not finite.
            ConfigError: The estimator refuses a parameter or the number of samples.
        """
        from sklearn.base import clone

        training = TrainingData(np.asarray(theta), np.asarray(time), np.asarray(position))
        if training.theta.shape[1] != len(self.template.parameters):
            raise TrainingDataError(
                f"theta has shape {training.theta.shape}; give (N, {len(self.template.parameters)}), one per parameter"
            )
        features = self._features(training.theta, training.time)
        input_scaling = _Scaling.of(features, self.config.inputs)
        outputs = training.position - self._expected(training.theta, training.time)
        output_scaling = _Scaling.of(outputs, self.config.outputs)
        inputs = input_scaling.apply(features)
        targets = output_scaling.apply(outputs)
        regressor = clone(self._unfitted)
        if self.config.estimator == PROCESS:
            noise = self._noise_of_the_prior(training, output_scaling) + regressor.alpha
            if len(inputs) > SEARCHED_SAMPLES and regressor.optimizer is not None:
                some = slice(None, None, -(-len(inputs) // SEARCHED_SAMPLES))
                set_noise(regressor, noise[some], inputs[some], targets[some])
                fit_quietly(regressor, inputs[some], targets[some], self.config.estimator)
                regressor = clone(regressor).set_params(kernel=regressor.kernel_, optimizer=None)
            set_noise(regressor, noise, inputs, targets)
        fit_quietly(regressor, inputs, targets, self.config.estimator)
        self._regressor, self._kernel_sum = regressor, kernel_sum(regressor, inputs)
        self._input_scaling, self._output_scaling, self._training = input_scaling, output_scaling, training
        return self

    def predict(self, theta: ArrayLike, time: ArrayLike) -> Array:
        """Predict hand positions (Eq. 2).

        Args:
            theta: Motion parameters, shape (N, n).
            time: Time since motion onset [s], shape (N,).

        Returns:
            Hand positions in the world frame [m], shape (N, 3).

        Raises:
            NotTrainedError: `fit` has not been called.
        """
        inputs = self._inputs(theta, time)
        with one_thread():
            if self._kernel_sum is not None:
                result = self._kernel_sum.evaluate(inputs)
            else:
                result = np.concatenate([self._regressor.predict(inputs[part]) for part in chunks(len(inputs))])
        # In place: half a million positions are predicted at once.
        result *= self._output_scaling.spread
        result += self._output_scaling.mean
        if self.prior is not None:
            result += self.prior.predict(theta, time)
        return result

    def predict_std(self, theta: ArrayLike, time: ArrayLike) -> Array:
        """Predict the standard deviation of hand positions, the noise of the samples included, and that of the prior.

        Args:
            theta: Motion parameters, shape (N, n).
            time: Time since motion onset [s], shape (N,).

        Returns:
            Standard deviation along each world axis [m], shape (N, 3).

        Raises:
            NotTrainedError: `fit` has not been called.
            ConfigError: The estimator knows no standard deviation.
        """
        inputs = self._inputs(theta, time)
        if not self.knows_std:
            raise ConfigError(
                f"estimator {self.config.estimator} predicts no standard deviation; use 'GaussianProcessRegressor'"
            )
        with one_thread():
            parts = [self._regressor.predict(inputs[part], return_std=True)[1] for part in chunks(len(inputs))]
        result = np.concatenate(parts) * self._output_scaling.spread
        if self.prior is not None and self.prior.knows_std:
            # Two errors that have nothing to do with each other.
            result = np.hypot(result, self.prior.predict_std(theta, time))
        return result

    @property
    def knows_std(self) -> bool:
        """Whether the estimator predicts a standard deviation."""
        return "return_std" in signature(self._unfitted.predict).parameters

    def refitted(self, theta: ArrayLike, time: ArrayLike, position: ArrayLike) -> "ForwardModel":
        """Return the same model of other samples; a fitted Gaussian process keeps its kernel, and the prior stays.

        Args:
            theta: Motion parameters, shape (N, n).
            time: Time since motion onset [s], shape (N,).
            position: Hand positions in the world frame [m], shape (N, 3).
        """
        from sklearn.base import clone

        other = ForwardModel(self.config, self.template, self.prior)
        if self.config.estimator == PROCESS:
            # 15 searches for a kernel take seconds, and one trial less would not find another.
            other._unfitted = clone(self._unfitted).set_params(kernel=self._regressor.kernel_, optimizer=None)
        return other.fit(theta, time, position)

    def _expected(self, theta: ArrayLike, time: ArrayLike) -> Array:
        """Return what is predicted before anything is learned [m], shape (N, 3)."""
        return np.zeros((len(np.asarray(theta)), 3)) if self.prior is None else self.prior.predict(theta, time)

    def _noise_of_the_prior(self, training: TrainingData, scaling: _Scaling) -> Array:
        """Return the variance that a process is to take for noise, in the scale of its targets, shape (N,).

        Where the prior is unsure, a sample says little about how the two bodies differ. The prior is off by about as
        much at all samples of a motion, so that together they say no more than one of them.
        """
        if self.prior is None or not self.prior.knows_std:
            return np.zeros(len(training.time))
        std = self.prior.predict_std(training.theta, training.time) / scaling.spread
        _, motion, samples = np.unique(training.theta, axis=0, return_inverse=True, return_counts=True)
        noise: Array = np.mean(std**2, axis=1) * samples[motion]
        return noise

    def _inputs(self, theta: ArrayLike, time: ArrayLike) -> Array:
        _ = self.training
        return self._input_scaling.apply(self._features(np.asarray(theta, float), np.asarray(time, float)))

    def _features(self, theta: Array, time: Array) -> Array:
        if self.config.time == "since_swing":
            time = time - self.template.swing_start(theta)
        return np.column_stack((theta, time))
