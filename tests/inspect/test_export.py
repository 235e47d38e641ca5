"""Exports hold what the log holds."""

import csv
import json
import math
import shutil
from importlib.metadata import version
from pathlib import Path

import pytest
from command_line import Run
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader
from pyarrow import parquet
from recorded_trials import Recorded

from imolo.config.loading import known_body
from imolo.errors import MissingToolError
from imolo.inspect.fields import column_name, leaves
from imolo.inspect.mcap_export import to_json
from imolo.machine.extras import import_extra
from imolo.messaging.channels import STREAMS
from imolo.messaging.log import Log, read_log
from imolo_msgs import actuator_state_t


def flatten(message: object) -> dict[str, object]:
    return {column_name(path): value for path, value in leaves(message)}


@pytest.fixture
def log(recorded: Recorded) -> Log:
    return read_log(recorded.first)


def test_csv_reads_back_as_the_same_numbers(recorded: Recorded, log: Log, run: Run, tmp_path: Path) -> None:
    code, output, errors = run("export", recorded.first, "--to", "csv", "--out", tmp_path / "tables")
    assert (code, errors, len(output.splitlines())) == (0, "", 9)
    for name in STREAMS:
        messages = log.messages[name]
        with (tmp_path / "tables" / f"{name}.csv").open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        assert [int(row["recorded_utime"]) for row in rows] == log.received[name]
        for row, message in zip(rows, messages, strict=True):
            fields = flatten(message)
            assert {key: value for key, value in row.items() if value} == {
                "recorded_utime": row["recorded_utime"],
                **{key: str(value) for key, value in fields.items() if str(value)},
            }


def test_parquet_reads_back_as_the_same_numbers(recorded: Recorded, log: Log, run: Run, tmp_path: Path) -> None:
    code, _, errors = run("export", recorded.first, "--to", "parquet", "--out", tmp_path)
    assert (code, errors) == (0, "")
    for name in STREAMS:
        messages = log.messages[name]
        rows = parquet.read_table(tmp_path / f"{name}.parquet").to_pylist()
        assert [row.pop("recorded_utime") for row in rows] == log.received[name]
        for row, message in zip(rows, messages, strict=True):
            assert {key: value for key, value in row.items() if value is not None} == flatten(message)


def test_mcap_holds_every_message_and_a_scene(recorded: Recorded, log: Log, run: Run, tmp_path: Path) -> None:
    code, output, _ = run("export", recorded.first, "--out", tmp_path / "log.mcap")
    assert (code, output.splitlines()[0]) == (0, str(tmp_path / "log.mcap"))
    found: dict[str, list[tuple[int, str, object]]] = {}
    with (tmp_path / "log.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            content = json.loads(message.data, parse_constant=pytest.fail)
            found.setdefault(channel.topic, []).append((message.log_time, schema.name, content))
    for name in STREAMS:
        messages = log.messages[name]
        expected = [
            (1000 * utime, f"imolo_msgs.{type(message).__name__}", to_json(message))
            for utime, message in zip(log.received[name], messages, strict=True)
        ]
        assert found.pop(name) == expected
    assert {topic: entries[0][1] for topic, entries in found.items()} == {
        "/scene": "foxglove.SceneUpdate",
        "/tf": "foxglove.FrameTransforms",
        "/robot_description": "std_msgs/String",
        "/joint_states": "sensor_msgs/JointState",
    }


def test_scene_is_what_foxglove_defines(recorded: Recorded, run: Run, tmp_path: Path) -> None:
    run("export", recorded.first, "--out", tmp_path / "log.mcap")
    with (tmp_path / "log.mcap").open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(topics=["/scene", "/tf"]):
            known = SceneUpdate if channel.topic == "/scene" else FrameTransforms
            _assert_fields(json.loads(message.data), known.DESCRIPTOR)


def _assert_fields(content: dict[str, object], descriptor: object) -> None:
    """The JSON schemas of Foxglove require every field of a message, empty lists included."""
    assert set(content) == set(descriptor.fields_by_name)  # type: ignore[attr-defined]
    for name, value in content.items():
        field = descriptor.fields_by_name[name]  # type: ignore[attr-defined]
        if name in ("timestamp", "lifetime"):
            assert set(value) == {"sec", "nsec"}  # type: ignore[call-overload]
            continue
        if name in ("rotation", "orientation"):
            assert math.hypot(*value.values()) == pytest.approx(1.0, abs=1e-9)  # type: ignore[attr-defined]
        for element in value if isinstance(value, list) else [value]:
            if isinstance(element, dict):
                _assert_fields(element, field.message_type)


def test_number_that_json_does_not_have_becomes_null() -> None:
    message = actuator_state_t()
    message.measured = [float("nan"), float("inf"), 1.0, *[0.0] * 5]
    assert to_json(message)["measured"][:3] == [None, None, 1.0]


def test_missing_package_is_advised_by_itself() -> None:
    with pytest.raises(MissingToolError, match=r'install it with: pip install "mcap>=[\d.]+" "pyarrow>=\d+"$'):
        import_extra("no_such_package", "export")


def test_columns_of_both_tables_tell_their_units(recorded: Recorded, run: Run, tmp_path: Path) -> None:
    for to in ("csv", "parquet"):
        assert run("export", recorded.first, "--to", to, "--out", tmp_path / to)[0] == 0
    about = json.loads((tmp_path / "csv/csv-metadata.json").read_text(encoding="utf-8"))
    assert about["@context"] == "http://www.w3.org/ns/csvw"
    assert {table["url"] for table in about["tables"]} >= {f"{name}.csv" for name in STREAMS}
    found = {}
    for table in about["tables"]:
        name = table["url"].removesuffix(".csv")
        columns = {column["name"]: column for column in table["tableSchema"]["columns"]}
        with (tmp_path / f"csv/{name}.csv").open(newline="", encoding="utf-8") as file:
            assert next(csv.reader(file)) == list(columns)
        fields = list(parquet.read_schema(tmp_path / f"parquet/{name}.parquet"))
        assert [field.name for field in fields] == list(columns)
        for field in fields:
            column = columns[field.name]
            unit, title = column.get("schema:unitText", ""), column["dc:description"]
            assert field.metadata.get(b"unit", b"").decode() == unit
            assert field.metadata[b"description"].decode() == title
            found[f"{name}.{field.name}"] = unit, title
    assert found["ACTUATOR_STATE.recorded_utime"] == ("us", "time of the recording")
    assert found["TRUTH_BALL.true_ball_position_2"] == ("m", "true_ball_position[2]")
    # Of these the robot says names and units.
    assert found["PLAN.theta_0"] == ("", "theta[k]")
    assert found["PLAN.theta_1"] == ("s", "theta[t_w]")
    assert found["ACTUATOR_STATE.measured_6"] == ("Pa", "measured[valve 7: raises both arms]")


def test_mcap_brings_robot_config_and_units(recorded: Recorded, run: Run, tmp_path: Path) -> None:
    for folder in ("logs", "configs"):
        (tmp_path / folder).mkdir()
    log = shutil.copy(recorded.first, tmp_path / "logs/one.lcmlog")
    messages = read_log(recorded.first).messages
    backend = messages["TRIAL"][0].backend
    (tmp_path / f"configs/{backend}.yaml").write_text("seed: 3\n", encoding="utf-8")
    run("export", log, "--out", tmp_path / "log.mcap")
    with (tmp_path / "log.mcap").open("rb") as file:
        reader = make_reader(file)
        attached = {each.name: each.data for each in reader.iter_attachments()}
        records = {each.name: each.metadata for each in reader.iter_metadata()}
        (model,) = [json.loads(each.data)["data"] for *_, each in reader.iter_messages(topics=["/robot_description"])]
        joints = [json.loads(each.data) for *_, each in reader.iter_messages(topics=["/joint_states"])]
        frames = [json.loads(each.data)["transforms"] for *_, each in reader.iter_messages(topics=["/tf"])]
    body = known_body("liberobot")
    assert body is not None
    assert attached == {"liberobot.urdf": body.urdf.read_bytes(), f"{backend}.yaml": b"seed: 3\n"}
    assert model == body.urdf.read_text(encoding="utf-8")
    assert records["imolo"] == {"source": str(log), "imolo": version("imolo"), "robot": "liberobot"}
    units = {
        "TRUTH_BALL.true_ball_position": "m",
        "MOCAP.markers.marker_position": "m",
        "PLAN.theta[t_w]": "s",
        "TRUTH_ROBOT.joint_velocity[right_knee]": "rad/s",
        "ACTUATOR_STATE.measured[valve 7: raises both arms]": "Pa",
    }
    assert records["units"].items() >= units.items()
    assert [each["position"] for each in joints] == [list(each.joint_angle) for each in messages["TRUTH_ROBOT"]]
    assert {tuple(each["name"]) for each in joints} == {body.joint_names}
    assert {frame["child_frame_id"] for (frame,) in frames} == {body.model.base}


def test_layout_for_foxglove_shows_what_an_export_has_with_schemas_that_its_panels_take(
    recorded: Recorded, run: Run, tmp_path: Path
) -> None:
    _, output, _ = run("export", recorded.first, "--out", tmp_path / "log.mcap")
    layout = json.loads(Path(output.splitlines()[1].partition(": ")[2]).read_text(encoding="utf-8"))
    with (tmp_path / "log.mcap").open("rb") as file:
        heard = {channel.topic: (schema, message) for schema, channel, message in make_reader(file).iter_messages()}
    names = {topic: schema.name for topic, (schema, _) in heard.items() if schema is not None}
    panels = layout["configById"]
    scene, robot = panels["3D!robot"], panels["3D!robot"]["layers"]["robot"]
    assert {names[topic] for topic in scene["topics"]} == {"foxglove.SceneUpdate"}
    assert names[robot["topic"]] == "std_msgs/String"
    assert names[robot["jointStatesTopic"]] == "sensor_msgs/JointState"
    for name, panel in panels.items():
        assert panel.get("topicPath", "TRIAL") in heard
        for series in panel.get("paths", []):
            topic, _, field = series["value"].partition(".")
            drawn = json.loads(heard[topic][1].data)[field.removesuffix("[:]")]
            assert drawn, name
            assert all(isinstance(number, float) for number in drawn), name
    places = json.dumps(layout["layout"])
    assert all(f'"{name}"' in places for name in panels)


def test_export_is_called_by_the_log_and_the_trial(recorded: Recorded, run: Run, tmp_path: Path) -> None:
    log = Path(shutil.copy(recorded.first, tmp_path / "ball.lcmlog"))
    for trial, name in ((), "ball.mcap"), (("--trial", "0"), "ball_trial_0.mcap"):
        code, _, errors = run("export", log, *trial)
        assert (code, errors) == (0, "")
        assert (tmp_path / name).exists()


def test_folder_that_cannot_be_written_is_one_line(recorded: Recorded, run: Run, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    for to in ("csv", "mcap"):
        code, _, errors = run("export", recorded.first, "--to", to, "--out", tmp_path / "file" / "below")
        assert (code, errors.count("\n"), "choose another --out" in errors) == (2, 1, True)
