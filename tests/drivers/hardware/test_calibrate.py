"""`imolo calibrate`: the robot in its ready pose tells where the cameras' frame lies."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from running_emulator import RunningEmulator, emulator
from scipy.spatial.transform import Rotation
from scripted_robot import scripted_robot
from typer.testing import CliRunner

from imolo.command_line.main import app
from imolo.config.loading import body_of, config_for
from imolo.errors import BackendNotFoundError, CalibrationError, ConfigError
from imolo_drivers.natnet.calibration import Z_UP, Calibration
from imolo_drivers.natnet.messages import AssetDefinition, AssetMarkerDefinition, ModelDefinitions

runner = CliRunner()
TURN = Rotation.from_euler("zyx", [130.0, 1.5, -2.0], degrees=True).as_matrix()
BODY = body_of(config_for("mujoco").robot)
HANDS = {effector.name for effector in BODY.effectors}  # which hang freely without air
READY = {name: place for name, place in BODY.ready_markers().items() if name not in HANDS}
ELSEWHERE = Calibration(rotation=tuple(map(tuple, (TURN @ Z_UP).tolist())), translation=(0.7, -1.3, 0.2))


def config(folder: Path, backend: dict[str, object], **sections: object) -> str:
    path = folder / "config.yaml"
    path.write_text(json.dumps({"backend": backend, **sections}), encoding="utf-8")  # JSON is YAML
    return str(path)


def hardware(running: RunningEmulator) -> dict[str, Any]:
    return {"name": "hardware", "cameras": {"command_port": running.robot.motive.port}}


def test_frame_of_cameras_that_stand_elsewhere_is_found(tmp_path: Path) -> None:
    out = tmp_path / "calibration.yaml"
    with emulator(calibration=ELSEWHERE) as running:
        path = config(tmp_path, hardware(running))
        result = runner.invoke(app, ["calibrate", path, "--out", str(out), "--seconds", "1"])
    assert result.exit_code == 0, result.output
    found = Calibration.load(out)
    assert set(found.markers) == set(READY)
    # Noise of 0.3 mm over at least 30 frames and 10 markers, and feet that sink 0.2 mm into the box.
    assert found.residual < 0.001
    # What stands 2 m before the robot and 2 m high is where it is, within 2 mm: 0.3 mm over 0.5 m of robot, times 4.
    places = np.array([*READY.values(), (2.0, 0.0, 2.0)])
    error = np.linalg.norm(found.to_world(ELSEWHERE.to_motive(places)) - places, axis=1)
    assert error[:-1].max() < 0.001
    assert error[-1] < 0.002
    assert f"calibration: {out}" in result.output
    assert all(name in result.output for name in READY)


def test_calibration_is_printed_where_no_file_is_asked_for(tmp_path: Path) -> None:
    with emulator() as running:
        result = runner.invoke(app, ["calibrate", config(tmp_path, hardware(running)), "--seconds", "0.5"])
    assert result.exit_code == 0, result.output
    printed = result.output.partition("\n\n")[2].partition("\n\n")[0]
    (tmp_path / "printed.yaml").write_text(printed, encoding="utf-8")
    np.testing.assert_allclose(Calibration.load(tmp_path / "printed.yaml").rotation, Z_UP, atol=0.002)


def test_markers_that_motive_calls_otherwise_are_known_by_their_labels(tmp_path: Path) -> None:
    """Motive says left where we say right, and the labels say so."""
    ours = {marker.name: marker.marker_id for marker in BODY.markers}
    other = {name: name.replace(*(("left", "right") if "left" in name else ("right", "left"))) for name in ours}
    with emulator() as running:
        renamed = (AssetMarkerDefinition(other[name], 1 + label, (0.0, 0.0, 0.0)) for name, label in ours.items())
        running.robot.motive.definitions = ModelDefinitions((AssetDefinition(BODY.name, 0, 1, (), tuple(renamed)),))
        backend = hardware(running)
        labels = {"markers": {other[name]: label for name, label in ours.items()}}
        path = config(tmp_path, {**backend, "cameras": {**backend["cameras"], "labels": labels}})
        result = runner.invoke(app, ["calibrate", path, "--out", str(tmp_path / "found.yaml"), "--seconds", "0.5"])
    assert result.exit_code == 0, result.output
    found = Calibration.load(tmp_path / "found.yaml")
    assert set(found.markers) == set(READY)
    np.testing.assert_allclose(found.rotation, Z_UP, atol=0.002)


def test_robot_in_another_pose_is_refused_and_a_marker_is_named(tmp_path: Path) -> None:
    """The robot without physics stands as no Liberobot can."""
    with scripted_robot() as robot:
        path = config(tmp_path, {"name": "hardware", "cameras": {"command_port": robot.motive.port}})
        result = runner.invoke(app, ["calibrate", path, "--seconds", "0.3"])
    assert isinstance(result.exception, CalibrationError)
    assert str(result.exception).split()[0] in READY
    assert "Check the names in Motive, the markers and the pose" in str(result.exception)


def test_hidden_marker_is_named(tmp_path: Path) -> None:
    with scripted_robot(lambda _, markers: [one for one in markers if one.marker_id != 11]) as robot:
        path = config(tmp_path, {"name": "hardware", "cameras": {"command_port": robot.motive.port}})
        result = runner.invoke(app, ["calibrate", path, "--seconds", "0.3"])
    assert isinstance(result.exception, CalibrationError)
    assert "the cameras saw right_toe in 0; " in str(result.exception)


def test_cameras_that_send_nothing_are_told(tmp_path: Path) -> None:
    path = config(tmp_path, {"name": "hardware", "patience": 0.2, "cameras": {"command_port": 1}})
    result = runner.invoke(app, ["calibrate", path])
    assert "no frames from Motive at 127.0.0.1:1 within 0.2 s" in str(result.exception)


@pytest.mark.parametrize(
    ("backend", "robot", "complaint"),
    [
        ("mujoco", "liberobot", "'mujoco', which has no cameras"),
        ("hardware", "athlete", "unknown robot 'athlete'"),
    ],
)
def test_config_that_cannot_be_calibrated_is_refused(tmp_path: Path, backend: str, robot: str, complaint: str) -> None:
    result = runner.invoke(app, ["calibrate", config(tmp_path, {"name": backend}, robot={"name": robot})])
    assert isinstance(result.exception, ConfigError | BackendNotFoundError)
    assert complaint in str(result.exception)
