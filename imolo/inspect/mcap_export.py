"""Logs as MCAP for Foxglove: every channel as JSON, and what happens as a 3D scene in Foxglove's own schemas.

The topics of our channels keep their names. `/scene` holds ball, markers, predicted path and target as
`foxglove.SceneUpdate`, `/tf` the trunk as `foxglove.FrameTransforms`.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from imolo.config.simulation import BallConfig
from imolo.machine.extras import import_extra
from imolo.messaging import channels
from imolo.messaging.channels import CHANNELS
from imolo.messaging.log import Log
from imolo_msgs import marker_t, mocap_frame_t, plan_t, truth_ball_t, truth_robot_t

Json = dict[str, Any]

WORLD = "world"
LIFETIME = 0.2  # [s] after which what was not seen again goes away
JSON_TYPES = {"string": "string", "float": "number", "double": "number", "boolean": "boolean"}
SHAPES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
BALL_COLOR, MARKER_COLOR, TARGET_COLOR, PATH_COLOR = (0.9, 0.2, 0.1), (0.3, 0.5, 0.9), (0.1, 0.7, 0.3), (0.9, 0.6, 0.1)


def write_mcap(log: Log, path: Path) -> None:
    """Write a log as MCAP.

    Raises:
        MissingToolError: The package `mcap` is not installed.
        OSError: The file cannot be written.
    """
    writer_module = import_extra("mcap.writer", "export")
    with path.open("wb") as file:
        writer = writer_module.Writer(file)
        writer.start(profile="", library="imolo")
        topics: dict[str, int] = {}
        for utime, topic, schema_name, schema, content in _messages(log):
            if topic not in topics:
                schema_id = writer.register_schema(schema_name, "jsonschema", json.dumps(schema).encode())
                topics[topic] = writer.register_channel(topic, "json", schema_id)
            nanoseconds = 1000 * utime
            data = json.dumps(content, allow_nan=True).encode()
            writer.add_message(topics[topic], nanoseconds, data, nanoseconds)
        writer.finish()


def _messages(log: Log) -> Iterator[tuple[int, str, str, Json, Json]]:
    """Yield time [µs], topic, name of the schema, schema and content in the order of the recording."""
    rows = [
        (received, name, message)
        for name, messages in log.messages.items()
        for received, message in zip(log.received[name], messages, strict=True)
    ]
    schemas = {name: json_schema(channel.message_type) for name, channel in CHANNELS.items()}
    for received, name, message in sorted(rows, key=lambda row: row[0]):
        yield received, name, f"imolo_msgs.{type(message).__name__}", schemas[name], to_json(message)
        if name == channels.TRUTH_ROBOT:
            yield received, "/tf", "foxglove.FrameTransforms", OPEN_SCHEMA, _trunk(message)
        draw = DRAWN.get(name)
        if draw is not None:
            yield received, "/scene", "foxglove.SceneUpdate", OPEN_SCHEMA, {"deletions": [], "entities": draw(message)}


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


def _trunk(truth: truth_robot_t) -> Json:
    w, x, y, z = to_json(list(truth.base_quaternion))
    transform = {
        "timestamp": _stamp(truth.utime),
        "parent_frame_id": WORLD,
        "child_frame_id": "trunk",
        "translation": _point(truth.base_position),
        "rotation": {"x": x, "y": y, "z": z, "w": w},
    }
    return {"transforms": [transform]}


def _draw_ball(truth: truth_ball_t) -> list[Json]:
    ball = _sphere(truth.true_ball_position, BallConfig().radius, BALL_COLOR)
    return [_entity(truth.utime, "ball", spheres=[ball])]


def _draw_markers(frame: mocap_frame_t) -> list[Json]:
    spheres = [
        _sphere(marker.marker_position, 0.015, BALL_COLOR if marker.marker_id == marker_t.UNLABELLED else MARKER_COLOR)
        for marker in frame.markers
    ]
    return [_entity(frame.utime, "markers", spheres=spheres)]


def _draw_plan(plan: plan_t) -> list[Json]:
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
    entities = [_entity(plan.utime, "predicted path", lines=[line])]
    if plan.plan_onset_utime:
        cube = {
            "pose": _pose(plan.target_position),
            "size": dict.fromkeys("xyz", 0.03),
            "color": _color(TARGET_COLOR, 0.7),
        }
        entities.append(_entity(plan.utime, "target", cubes=[cube]))
    return entities


DRAWN: dict[str, Callable[[Any], list[Json]]] = {
    channels.TRUTH_BALL: _draw_ball,
    channels.MOCAP: _draw_markers,
    channels.PLAN: _draw_plan,
}
