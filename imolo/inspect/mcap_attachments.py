"""What an MCAP file brings with it, so that it can be read without imolo: robot models, configs and units."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

from imolo.config.loading import known_body
from imolo.contracts.mesh import find_mesh
from imolo.contracts.robot import Body
from imolo.errors import BackendError
from imolo.inspect.definitions import field_units
from imolo.inspect.names import NAMED
from imolo.messaging.channels import CHANNELS
from imolo_msgs import robot_t, trial_event_t

LEVELS = 5  # folders above a log in which its `configs/` is looked for


class Attachment(NamedTuple):
    """A file in the file."""

    name: str
    media_type: str
    data: bytes


class Started:
    """The trials that have started so far in a log.

    Attributes:
        robots: What ROBOT said, by the name of the robot.
        body: Of the robot of the newest trial; None where it is not installed.
        urdf: Its model.
        attachments: Models with their meshes, and configs, each once.
        about: What was found, for people.
    """

    def __init__(self, log: Path) -> None:
        """Prepare for a log, beside which configs may lie, as in a results folder."""
        self._log = log
        self._robot = self._backend = ""
        self.robots: dict[str, robot_t] = {}
        self.body: Body | None = None
        self.urdf = ""
        self.attachments: list[Attachment] = []
        self.about: dict[str, str] = {}

    def begin(self, start: trial_event_t) -> bool:
        """Take note of a start; return whether a model is to be shown that was not shown before."""
        if start.backend != self._backend:
            self._backend = start.backend
            self._attach(_config(self._log, start.backend))
        if start.robot == self._robot:
            return False
        self._robot = start.robot
        self.body = known_body(start.robot)
        if self.body is None:
            self.about["robot"] = f"{start.robot}, which is not installed here: no model is attached"
            return False
        self.about["robot"] = start.robot
        self.urdf = self.body.urdf.read_text(encoding="utf-8")
        self._attach(Attachment(f"{start.robot}.urdf", "application/xml", self.urdf.encode()))
        for mesh in _meshes(self.body.urdf):
            self._attach(mesh)
        return True

    def _attach(self, attachment: Attachment | None) -> None:
        if attachment is not None and attachment not in self.attachments:
            self.attachments.append(attachment)

    def units(self) -> dict[str, str]:
        """Return the unit of every field that has one, and of the elements whose units the robot says."""
        units = {
            f"{name}.{path}": unit for name, channel in CHANNELS.items() for path, unit in _units(channel.message_type)
        }
        for robot in self.robots.values():
            for (channel, field), (_, names, of_names, suffix) in NAMED.items():
                for name, unit in zip(getattr(robot, names), getattr(robot, of_names, ()), strict=False):
                    units[f"{channel}.{field}[{name}]"] = unit and unit + suffix
        return {name: unit for name, unit in units.items() if unit}


def _units(message_type: type[Any]) -> Iterator[tuple[str, str]]:
    import imolo_msgs

    for name, kind in zip(message_type.__slots__, message_type.__typenames__, strict=True):
        yield name, field_units().get((message_type.__name__, name), "")
        nested = getattr(imolo_msgs, kind.rpartition(".")[2], None) if "." in kind else None
        if nested is not None:
            yield from ((f"{name}.{inner}", unit) for inner, unit in _units(nested))


def _config(log: Path, backend: str) -> Attachment | None:
    """Return the resolved config of the results folder that a log is in."""
    for folder in log.resolve().parents[:LEVELS]:
        path = folder / "configs" / f"{Path(backend).name}.yaml"
        if path.is_file():
            return Attachment(f"{backend}.yaml", "application/yaml", path.read_bytes())
    return None


def _meshes(urdf: Path) -> Iterator[Attachment]:
    """Yield the meshes of a model under the names that it gives them."""
    for mesh in ElementTree.parse(urdf).iter("mesh"):
        name = mesh.get("filename", "")
        try:
            data = find_mesh(name, urdf.parent).read_bytes()
        except (BackendError, OSError):
            continue  # a mesh that is seen only may be missing
        yield Attachment(name, "application/octet-stream", data)
