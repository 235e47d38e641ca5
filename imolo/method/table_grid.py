"""What a lookup table is to predict, and how finely it is stored (Secs. IV-B, VII-B)."""

from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from imolo.config.model import Model
from imolo.errors import ConfigError
from imolo.method.motion import MotionTemplate

Array = NDArray[np.float64]


class GridAxis(Model):
    """Evenly spaced values from start on, none beyond stop; in the unit of the parameter.

    Attributes:
        start: The first value.
        stop: None is beyond it.
        step: From one value to the next.
    """

    start: float
    stop: float
    step: float = Field(gt=0.0)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.stop < self.start:
            raise ValueError(f"stop is {self.stop:g}; give at least start, {self.start:g}")
        return self

    def values(self) -> Array:
        """Return the values, shape (N,)."""
        count = int(np.floor((self.stop - self.start) / self.step + 1e-6)) + 1
        return np.round(self.start + self.step * np.arange(count), 9)


class TableGrid(Model):
    """What is predicted and how finely it is stored; spacing and tolerance are those of Sec. VII-B.

    Attributes:
        parameters: Predicted values of each parameter of the motion, by its name; all combinations are predicted.
        time_since_swing: Times since the start of the swing of the predicted positions [s]; t - t_w in the paper.
        spacing: d_grid, interval of the grid points [m]; they lie at its multiples along the world axes.
        time_tolerance: Δt [s].
        unique: How many predictions of one grid point are stored (Sec. IV-B2): "voxel", one of them at random as in
            the paper; "voxel_time", one of each time t at random; "all".
        match: Which queries belong to a grid point: "sphere", those nearer than half the spacing as in Sec. IV-A, which
            leaves out 48 % of space; "cell", all that are nearest to it.
    """

    parameters: Annotated[dict[str, GridAxis], Field(min_length=1, max_length=4)]
    time_since_swing: GridAxis
    spacing: float = Field(default=0.010, gt=0.0)
    time_tolerance: float = Field(default=0.0083, gt=0.0)
    unique: Literal["voxel", "voxel_time", "all"] = "voxel"
    match: Literal["sphere", "cell"] = "sphere"

    def predictions(self, template: MotionTemplate) -> tuple[Array, Array]:
        """Return theta (N, n) and time since the onset [s] (N,) of all that is predicted.

        Raises:
            ConfigError: The grid is not over the parameters of the motion.
        """
        self.check(template)
        axes = [axis.values() for axis in self.parameters.values()]
        *columns, since = (part.ravel() for part in np.meshgrid(*axes, self.time_since_swing.values(), indexing="ij"))
        named = dict(zip(self.parameters, columns, strict=True))
        theta = np.column_stack([named[parameter.name] for parameter in template.parameters])
        return theta, np.round(template.swing_start(theta) + since, 9)

    def check(self, template: MotionTemplate) -> None:
        """Raise `ConfigError` unless the grid is over the parameters of the motion."""
        names = [parameter.name for parameter in template.parameters]
        if set(names) != set(self.parameters):
            raise ConfigError(
                f"the grid is over {', '.join(self.parameters)}, the motion has {', '.join(names)}; give each an axis"
            )

    def bounds(self, template: MotionTemplate) -> tuple[Array, Array]:
        """Return the lowest and the highest theta of the grid, each of shape (n,)."""
        self.check(template)
        axes = [self.parameters[parameter.name] for parameter in template.parameters]
        return np.array([axis.start for axis in axes]), np.array([axis.stop for axis in axes])
