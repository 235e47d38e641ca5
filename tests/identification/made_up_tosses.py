"""Tosses whose truth is known: parabolas, and bodies thrown in an engine."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imolo.config.experiment import PluginConfig
from imolo.config.simulation import ContactConfig
from imolo.identification.experiment import Errors
from imolo.identification.free_body import (
    POSE,
    TWIST,
    BodyConfig,
    FreeBodyConfig,
    FreeBodySimulation,
    Toss,
    rotations,
    simulate,
)

Array = NDArray[np.float64]

SIDE = 0.1  # [m]
CUBE = BodyConfig(sides=(SIDE,) * 3, mass=0.4)
RATE = 148.0  # [Hz]
TIMESTEP = 1.0 / (5.0 * RATE)
MU = 0.25
STUDY = f"""
kind: free_body
data: tosses.csv
body: {{sides: [{SIDE}, {SIDE}, {SIDE}], mass: 0.4}}
simulation: {{timestep: {TIMESTEP}}}
engines: [mujoco]
parameters:
  simulation.contact.friction: {{range: [0.05, 1.5], scale: log}}
training: 8
evaluations: 30
halve_timestep: false
"""


def cube_config(name: str = "mujoco", friction: float = MU, **options: Any) -> FreeBodyConfig:
    simulation = FreeBodySimulation(timestep=TIMESTEP, contact=ContactConfig(friction=friction))
    return FreeBodyConfig(backend=PluginConfig(name=name, **options), simulation=simulation, body=CUBE)


def parabolas(
    number: int = 12,
    gravity: float = 9.81,
    noise: float = 0.0,
    frames: int = 30,
    axes: tuple[int, int, int] = (0, 1, 2),
    seed: int = 0,
) -> list[Toss]:
    """Return flights without a landing; `axes` says which of x, y, z (up) becomes which column."""
    chance = np.random.default_rng(seed)
    time = np.arange(frames) / RATE
    tosses = []
    for index in range(number):
        start = np.array([0.0, 0.0, 1.0]) + chance.uniform(-0.1, 0.1, 3)
        velocity = np.array([*chance.uniform(-1.0, 1.0, 2), 1.0])
        fall = 0.5 * np.array([0.0, 0.0, -gravity])
        position = (start + velocity * time[:, None] + fall * time[:, None] ** 2)[:, list(axes)]
        position += noise * chance.normal(size=position.shape)
        rotation = np.tile([1.0, 0.0, 0.0, 0.0], (frames, 1))
        tosses.append(Toss(str(index), time, position, rotation, velocity[list(axes)], np.zeros(3)))
    return tosses


def thrown(config: FreeBodyConfig, number: int = 20, duration: float = 0.7, seed: int = 3) -> list[Toss]:
    """Throw the cube in an engine."""
    chance = np.random.default_rng(seed)
    time = np.arange(round(duration * RATE)) / RATE
    tosses = []
    for index in range(number):
        rotation = chance.normal(size=4)
        rotation /= np.linalg.norm(rotation)
        height = SIDE + chance.uniform(0.02, 0.1)
        velocity = np.array([*chance.uniform(-1.2, 1.2, 2), chance.uniform(-0.5, 0.3)])
        blank = Toss(
            str(index),
            time,
            np.tile([0.0, 0.0, height], (len(time), 1)),
            np.tile(rotation, (len(time), 1)),
            velocity,
            chance.uniform(-6.0, 6.0, 3),
        )
        position, turn = simulate(config, blank)
        x, y, z, w = turn.as_quat().T
        tosses.append(replace(blank, position=position, rotation=np.stack([w, x, y, z], axis=1)))
    return tosses


def rows(tosses: list[Toss]) -> list[dict[str, Any]]:
    """Return tosses as the rows of a CSV; the twist stands in every row, that of the first frame counts."""
    table = []
    for toss in tosses:
        spin = rotations(toss.rotation)[0].inv().apply(toss.angular_velocity)
        for time, position, rotation in zip(toss.time, toss.position, toss.rotation, strict=True):
            values = [*position.tolist(), *rotation.tolist(), *toss.velocity.tolist(), *spin.tolist()]
            table.append({"toss": toss.name, "time_s": float(time), **dict(zip((*POSE, *TWIST), values, strict=True))})
    return table


def write(path: Path, table: list[dict[str, Any]]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(table[0]))
        writer.writeheader()
        writer.writerows(table)
    return path


class Parabola:
    """A `Recording` whose errors are a known function of friction times gravity: a fit of it needs no engine."""

    def __init__(self, name: str, truth: float, problem: type[Exception] | None = None) -> None:
        self.name = name
        self.truth = truth
        self.problem = problem
        self.plays = 0

    def play(self, config: FreeBodyConfig) -> Errors:
        self.plays += 1
        friction = config.simulation.contact.friction
        if self.problem is not None and friction < 0.1:
            raise self.problem("the engine fell over")
        off = np.log(friction * config.simulation.gravity / 9.81 / self.truth)
        return {"position": np.array([[off, 0.1, 0.0]]), "rotation": np.array([[0.5 * off, 0.1, 0.0]])}
