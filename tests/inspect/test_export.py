"""Exports hold what the log holds."""

import csv
import json
from pathlib import Path

import pytest
from command_line import Run
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader
from pyarrow import parquet
from recorded_trials import Recorded

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
    assert (code, output.strip()) == (0, str(tmp_path / "log.mcap"))
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
        for element in value if isinstance(value, list) else [value]:
            if isinstance(element, dict):
                _assert_fields(element, field.message_type)


def test_number_that_json_does_not_have_becomes_null() -> None:
    message = actuator_state_t()
    message.measured = [float("nan"), float("inf"), 1.0, *[0.0] * 5]
    assert to_json(message)["measured"][:3] == [None, None, 1.0]


def test_unknown_format_is_refused_with_the_nearest(recorded: Recorded, run: Run) -> None:
    code, _, errors = run("export", recorded.first, "--to", "parket")
    assert code == 2
    assert errors == "imolo: unknown format 'parket'; did you mean 'parquet'?; known: mcap, csv, parquet\n"


def test_missing_package_names_the_extra() -> None:
    with pytest.raises(MissingToolError, match=r"install it with: pip install 'imolo\[export\]'"):
        import_extra("no_such_package", "export")


def test_folder_that_cannot_be_written_is_one_line(recorded: Recorded, run: Run, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    for to in ("csv", "mcap"):
        code, _, errors = run("export", recorded.first, "--to", to, "--out", tmp_path / "file" / "below")
        assert (code, errors.count("\n"), "choose another --out" in errors) == (2, 1, True)
