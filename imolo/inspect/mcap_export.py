"""Logs as MCAP for Foxglove: every channel as JSON, and what happens as a 3D scene in Foxglove's own schemas.

The topics of our channels keep their names. `/scene` holds ball, markers, predicted path and target as
`foxglove.SceneUpdate`, `/tf` the base of the robot as `foxglove.FrameTransforms`, and `/robot_description` and
`/joint_states` its model and how it moves, as ROS has them.
"""

import json
import struct
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO

from imolo.config.simulation import BallConfig
from imolo.contracts.trial import EventName
from imolo.errors import ResultsError
from imolo.inspect.mcap_attachments import Started
from imolo.inspect.trials import TrialEvents
from imolo.machine.extras import import_extra
from imolo.messaging import channels
from imolo.messaging.channels import CHANNELS
from imolo.messaging.log import decoded
from imolo_msgs import marker_t, mocap_frame_t, plan_t, truth_ball_t, truth_robot_t

Json = dict[str, Any]

LAYOUT = Path(__file__).with_name("foxglove_layout.json")
WORLD = "world"
LIFETIME = 0.2  # [s] after which what was not seen again goes away
JSON_TYPES = {"string": "string", "float": "number", "double": "number", "boolean": "boolean"}
UNITS = "units"  # name of the record that holds the units of fields, such as ACTUATOR_STATE.measured
METADATA = "imolo"  # name of the record that says what a file is made of
LAST_TIME = (1 << 64) - 1  # [ns] of MCAP
DELETE_ALL = 1  # foxglove.SceneEntityDeletion
SHAPES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
BALL_COLOR, MARKER_COLOR, TARGET_COLOR, PATH_COLOR = (0.9, 0.2, 0.1), (0.3, 0.5, 0.9), (0.1, 0.7, 0.3), (0.9, 0.6, 0.1)


def write_mcap(events: TrialEvents, file: BinaryIO, source: str) -> None:
    """Write the messages of a log as MCAP.

    Every time that Foxglove looks at is on the clock of the recording, which rises from trial to trial, while the clock
    inside the messages may begin again with each of them.

    Args:
        events: Of the log.
        file: Where to write.
        source: What the file is made of, for `source_of`.

    Raises:
        BusError: The log cannot be read, or holds nothing of ours.
        MissingToolError: The package `mcap` is not installed.
        OSError: The file cannot be written.
        ResultsError: The log is stamped before zero, or after the last time that MCAP knows.
    """
    writer_module = import_extra("mcap.writer", "export")
    writer = writer_module.Writer(file)
    writer.start(profile="", library="imolo")
    topics: dict[str, int] = {}
    started = Started(events.reader.path)
    for utime, topic, schema_name, schema, content in _messages(events, started):
        if topic not in topics:
            schema_id = writer.register_schema(schema_name, "jsonschema", json.dumps(schema).encode())
            topics[topic] = writer.register_channel(topic, "json", schema_id)
        nanoseconds = 1000 * utime
        if not 0 <= nanoseconds <= LAST_TIME:
            raise ResultsError(
                f"{events.reader.path} has a message recorded at {utime} us, and MCAP has times from 0 to "
                f"{LAST_TIME // 1000} us only; is the log stamped in microseconds? --to csv takes any time"
            )
        data = json.dumps(content, allow_nan=True).encode()
        writer.add_message(topics[topic], nanoseconds, data, nanoseconds)
    if not topics:
        raise events.nothing()
    for attached in started.attachments:
        writer.add_attachment(0, 0, attached.name, attached.media_type, attached.data)
    writer.add_metadata(UNITS, started.units())
    writer.add_metadata(METADATA, {"source": source, "imolo": version("imolo"), **started.about})
    writer.finish()


def source_of(path: Path) -> str | None:
    """Return what an MCAP file of ours is made of; None for another file.

    Raises:
        MissingToolError: The package `mcap` is not installed.
        OSError: The file cannot be read.
    """
    reader_module = import_extra("mcap.reader", "export")
    errors = import_extra("mcap.exceptions", "export")
    with path.open("rb") as file:
        try:
            found = [data.metadata for data in reader_module.make_reader(file).iter_metadata() if data.name == METADATA]
        except (errors.McapError, ValueError, struct.error):
            return None
    return found[0].get("source") if found else None


def _messages(events: TrialEvents, started: Started) -> Iterator[tuple[int, str, str, Json, Json]]:
    """Yield time [µs], topic, name of the schema, schema and content in the order of the recording."""
    schemas = {name: json_schema(channel.message_type) for name, channel in CHANNELS.items()}
    for event, message in decoded(events, events.reader, CHANNELS):
        name, recorded = event.channel, event.utime + events.reader.shift
        yield recorded, name, f"imolo_msgs.{type(message).__name__}", schemas[name], to_json(message)
        if name == channels.ROBOT:
            started.robots[message.robot_name] = message
        if name == channels.TRIAL and message.event == EventName.START and started.begin(message):
            yield recorded, "/robot_description", "std_msgs/String", OPEN_SCHEMA, {"data": started.urdf}
        if name == channels.TRUTH_ROBOT:
            base = started.body.model.base if started.body else "base"
            yield recorded, "/tf", "foxglove.FrameTransforms", OPEN_SCHEMA, _base(message, base, recorded)
            if started.body:
                joints = _joints(message, started.body.joint_names, recorded)
                yield recorded, "/joint_states", "sensor_msgs/JointState", OPEN_SCHEMA, joints
        if name == channels.TRIAL and message.event == EventName.START:
            # What is left of the trial before does not belong to this one.
            everything = {"timestamp": _stamp(recorded), "type": DELETE_ALL, "id": ""}
            yield recorded, "/scene", "foxglove.SceneUpdate", OPEN_SCHEMA, {"deletions": [everything], "entities": []}
        draw = DRAWN.get(name)
        if draw is not None:
            entities = draw(message, recorded)
            yield recorded, "/scene", "foxglove.SceneUpdate", OPEN_SCHEMA, {"deletions": [], "entities": entities}


OPEN_SCHEMA: Json = {"type": "object"}  # Foxglove knows its own schemas by their names


def json_schema(message_type: type[Any]) -> Json:
    """Return the JSON schema of a message type."""
    import imolo_msgs

    properties: Json = {}
    for name, kind, sides in zip(
        message_type.__slots__, message_type.__typenames__, message_type.__dimensions__, strict=True
    ):
        nested = getattr(imolo_msgs, kind.rpartition(".")[2], None) if "." in kind else None
        schema: Json = json_schema(nested) if nested is not None else {"type": JSON_TYPES.get(kind, "integer")}
        for _ in sides or ():
            schema = {"type": "array", "items": schema}
        properties[name] = schema
    return {"type": "object", "properties": properties}


def to_json(value: Any) -> Any:
    """Return a message as dictionaries and lists."""
    if hasattr(value, "__slots__"):
        return {name: to_json(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, list | tuple):
        return [to_json(element) for element in value]
    # JSON has no infinities and no NaN, and Foxglove refuses a message with one.
    return value if not isinstance(value, float) or value - value == 0.0 else None


def _stamp(utime: int) -> Json:
    return {"sec": utime // 1_000_000, "nsec": 1000 * (utime % 1_000_000)}


def _point(position: Sequence[float]) -> Json:
    return dict(zip("xyz", to_json(list(position)), strict=True))


def _pose(position: Sequence[float]) -> Json:
    return {"position": _point(position), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}


def _color(color: Sequence[float], opacity: float = 1.0) -> Json:
    return {**dict(zip("rgb", color, strict=True)), "a": opacity}


def _entity(utime: int, identity: str, **shapes: list[Json]) -> Json:
    lifetime = {"sec": 0, "nsec": round(LIFETIME * 1e9)}
    header = {"timestamp": _stamp(utime), "frame_id": WORLD, "id": identity, "lifetime": lifetime}
    # Foxglove's schema requires every list, be it empty.
    return {**header, "frame_locked": False, "metadata": [], **{name: [] for name in SHAPES}, **shapes}


def _sphere(position: Sequence[float], radius: float, color: Sequence[float], opacity: float = 1.0) -> Json:
    return {
        "pose": _pose(position),
        "size": dict.fromkeys("xyz", 2.0 * radius),
        "color": _color(color, opacity),
    }


def _base(truth: truth_robot_t, link: str, utime: int) -> Json:
    w, x, y, z = to_json(list(truth.base_quaternion))
    transform = {
        "timestamp": _stamp(utime),
        "parent_frame_id": WORLD,
        "child_frame_id": link,
        "translation": _point(truth.base_position),
        "rotation": {"x": x, "y": y, "z": z, "w": w},
    }
    return {"transforms": [transform]}


def _joints(truth: truth_robot_t, names: Sequence[str], utime: int) -> Json:
    return {
        "header": {"stamp": _stamp(utime), "frame_id": ""},
        "name": list(names),
        "position": to_json(truth.joint_angle),
        "velocity": to_json(truth.joint_velocity),
        "effort": [],
    }


def _draw_ball(truth: truth_ball_t, utime: int) -> list[Json]:
    ball = _sphere(truth.true_ball_position, BallConfig().radius, BALL_COLOR)
    return [_entity(utime, "ball", spheres=[ball])]


def _draw_markers(frame: mocap_frame_t, utime: int) -> list[Json]:
    spheres = [
        _sphere(marker.marker_position, 0.015, BALL_COLOR if marker.marker_id == marker_t.UNLABELLED else MARKER_COLOR)
        for marker in frame.markers
    ]
    return [_entity(utime, "markers", spheres=spheres)]


def _draw_plan(plan: plan_t, utime: int) -> list[Json]:
    line = {
        "type": 0,
        "pose": _pose((0.0, 0.0, 0.0)),
        "thickness": 0.01,
        "scale_invariant": False,
        "points": [_point(position) for position in plan.predicted_position],
        "color": _color(PATH_COLOR),
        "colors": [],
        "indices": [],
    }
    entities = [_entity(utime, "predicted path", lines=[line])]
    if plan.plan_onset_utime:
        cube = {
            "pose": _pose(plan.target_position),
            "size": dict.fromkeys("xyz", 0.03),
            "color": _color(TARGET_COLOR, 0.7),
        }
        entities.append(_entity(utime, "target", cubes=[cube]))
    return entities


DRAWN: dict[str, Callable[[Any, int], list[Json]]] = {
    channels.TRUTH_BALL: _draw_ball,
    channels.MOCAP: _draw_markers,
    channels.PLAN: _draw_plan,
}
