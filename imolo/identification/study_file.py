"""What a study's YAML file may say."""

from pathlib import Path
from typing import Literal

from imolo.config.model import Positive
from imolo.config.reading import check_model, read_yaml
from imolo.contracts.urdf import read_urdf
from imolo.errors import ConfigError, TrainingDataError, did_you_mean
from imolo.identification.experiment import Experiment, Quantity
from imolo.identification.facts_study import FactsStudy
from imolo.identification.free_body import (
    BodyConfig,
    FreeBodyConfig,
    FreeBodySimulation,
    as_metres,
    digest,
    read_tosses,
)
from imolo.identification.free_body_checks import check_tosses, start_from_flight
from imolo.identification.robot_log_study import RobotLogStudy
from imolo.identification.study_config import StudyConfig

LEAST = "it needs at least kind and parameters"


class FreeBodyStudy(StudyConfig):
    """Engines fitted to recordings of a body that flies, hits the floor and comes to rest.

    Attributes:
        data: CSV of the recordings, see `read_tosses`.
        held_out_data: CSV of further recordings, on which alone the fits are judged.
        body: The body.
        simulation: What surrounds it.
        length_factor: Lengths of the recordings are multiplied by it; the check of the data says by what.
        start: Whether a toss starts as its first frame says, or as its frames in the air do.
        position_scale: An error of this size counts one in the loss [m]; the longest side of a box if not given.
        rotation_scale: Likewise [rad].
    """

    kind: Literal["free_body"]
    data: Path
    held_out_data: Path | None = None
    body: BodyConfig
    simulation: FreeBodySimulation = FreeBodySimulation()
    length_factor: Positive = 1.0
    start: Literal["recorded", "flight"] = "recorded"
    position_scale: Positive | None = None
    rotation_scale: Positive = 1.0

    def experiment(self, folder: Path) -> Experiment:
        """Read and check the recordings; paths are relative to a folder."""
        body = self.body
        if body.urdf is not None:
            urdf = folder / body.urdf
            _check_body(urdf)
            body = body.model_copy(update={"urdf": urdf})
        tosses = read_tosses(folder / self.data)
        fitted = len(tosses)
        if self.held_out_data is not None:
            tosses += read_tosses(folder / self.held_out_data)
            names = [toss.name for toss in tosses]
            if both := sorted(set(names[:fitted]) & set(names[fitted:])):
                raise TrainingDataError(f"toss {both[0]!r} is in data and in held_out_data; leave it out of one")
        tosses = [as_metres(toss, self.length_factor) for toss in tosses]
        cube = body.sides is not None and len(set(body.sides)) == 1
        resting = 0.5 * body.sides[0] if cube and body.sides else None
        findings = check_tosses(tosses, body, resting, self.simulation.gravity)
        if self.start == "flight":
            tosses = [start_from_flight(toss, body) for toss in tosses]
        size = self.position_scale or (max(body.sides) if body.sides else 0.1)
        quantities = (
            Quantity("position", "% of size", 100.0 / size, size),
            Quantity("rotation", "deg", 57.29577951308232, self.rotation_scale),
        )
        configs = {
            label: FreeBodyConfig(backend=backend, simulation=self.simulation, body=body)
            for label, backend in self.backends().items()
        }
        apart = range(fitted, len(tosses))
        return Experiment(tosses, quantities, findings, configs, "absolute", digest(tosses, body.urdf), apart)


def _check_body(urdf: Path) -> None:
    model = read_urdf(urdf)
    if len(model.links) != 1 or not model.links[model.base].collisions:
        raise ConfigError(f"{urdf} has {len(model.links)} links; a free body is one link with a collision shape")


KINDS: dict[str, type[StudyConfig] | type[FactsStudy]] = {
    "free_body": FreeBodyStudy,
    "facts": FactsStudy,
    "robot_logs": RobotLogStudy,
}


def load_study(path: Path) -> StudyConfig | FactsStudy:
    """Read and check a study's file.

    Raises:
        ConfigError: The file cannot be read, a key is unknown, or a value is out of range.
    """
    content = read_yaml(path, LEAST)
    kind = content.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        hint = did_you_mean(str(kind), KINDS)
        raise ConfigError(f"{path}: kind is {kind!r}{hint}; give one of: {', '.join(KINDS)}")
    return check_model(content, KINDS[kind], str(path))
