"""The world frame from markers at known places, and our labels of Motive's markers."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from natnet_capture import frames, recording
from scipy.spatial.transform import Rotation

from imolo.config.loading import body_of, config_for
from imolo.errors import CalibrationError, NatNetError
from imolo_drivers.natnet import messages as m
from imolo_drivers.natnet.calibration import Z_UP, Calibration, CalibrationLimits, fit
from imolo_drivers.natnet.config import MarkerLabels, NamedMarkers
from imolo_drivers.natnet.markers import find_labels, mocap_frame, rest_positions
from imolo_msgs import marker_t

KNOWN = {
    "right_hand": (0.1, -0.3, 0.9),
    "left_hand": (0.1, 0.3, 0.9),
    "right_toe": (0.0, -0.1, 0.4),
    "left_toe": (0.0, 0.1, 0.4),
    "right_hip": (-0.2, 0.0, 0.6),
}
angle = st.floats(-math.pi, math.pi)
small_tilt = st.floats(-math.radians(3.0), math.radians(3.0))
length = st.floats(-5.0, 5.0)


def seen_by_cameras(rotation: np.ndarray, translation: np.ndarray, noise: np.ndarray | float = 0.0) -> dict:
    """Known markers in the frame of cameras whose floor stands so in the world."""
    places = (np.array(list(KNOWN.values())) - translation) @ (rotation @ Z_UP) + noise
    return dict(zip(KNOWN, map(tuple, places.tolist()), strict=True))


def test_motives_z_is_forward_its_x_left_its_y_up() -> None:
    assert Calibration().to_world(np.eye(3)).tolist() == [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]
    assert Calibration().residual == 0.0


@given(turn=angle, tilt=st.tuples(small_tilt, small_tilt), translation=st.tuples(length, length, length))
def test_the_fit_finds_where_the_cameras_frame_stands(
    turn: float, tilt: tuple[float, float], translation: tuple[float, float, float]
) -> None:
    rotation = Rotation.from_euler("zyx", [turn, *tilt]).as_matrix()
    calibration = fit(seen_by_cameras(rotation, np.array(translation)), KNOWN)
    np.testing.assert_allclose(calibration.rotation, rotation @ Z_UP, atol=1e-9)
    np.testing.assert_allclose(calibration.translation, translation, atol=1e-9)
    assert calibration.residual < 1e-9
    points = np.array(list(KNOWN.values()))
    np.testing.assert_allclose(calibration.to_world(calibration.to_motive(points)), points, atol=1e-9)


def test_noise_shows_in_the_residual() -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.002, (len(KNOWN), 3))
    calibration = fit(seen_by_cameras(np.eye(3), np.zeros(3), noise), KNOWN)
    # Six of the 15 coordinates go into the pose.
    assert calibration.residual == pytest.approx(0.002 * math.sqrt(3 * (15 - 6) / 15), rel=0.5)


def test_a_mirrored_arrangement_does_not_fit() -> None:
    mirrored = {name: (-x, y, z) for name, (x, y, z) in seen_by_cameras(np.eye(3), np.zeros(3)).items()}
    with pytest.raises(CalibrationError, match="root mean square"):
        fit(mirrored, {name: (x, y + 0.1 * i, z) for i, (name, (x, y, z)) in enumerate(KNOWN.items())})


def test_two_swapped_markers_do_not_fit_and_one_is_named() -> None:
    seen = seen_by_cameras(np.eye(3), np.zeros(3))
    seen["right_hand"], seen["right_hip"] = seen["right_hip"], seen["right_hand"]
    with pytest.raises(CalibrationError, match=r"^right_(hand|hip) is off by .*Check the names"):
        fit(seen, KNOWN)


def test_one_marker_that_came_off_is_named_though_all_others_fit() -> None:
    known = {f"marker {i}": place for i, place in enumerate(np.random.default_rng(1).normal(size=(10, 3)).tolist())}
    seen = dict(zip(known, Calibration().to_motive(np.array(list(known.values()))).tolist(), strict=True))
    assert fit(seen, known).residual < 1e-9
    seen["marker 7"][1] += 0.028
    with pytest.raises(
        CalibrationError,
        match=r"^marker 7 is off by 2\d\.. mm, .* \(marker 0, .*, marker 9\) by [78]\.. mm "
        r"\(root mean square\), at most 10\.0 mm\.",
    ):
        fit(seen, known)


def test_errors_are_the_distances_that_the_fit_leaves() -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.002, (len(KNOWN), 3))
    seen = seen_by_cameras(np.eye(3), np.zeros(3), noise)
    calibration = fit(seen, KNOWN)
    errors = calibration.errors(seen, KNOWN)
    assert errors.keys() == KNOWN.keys()
    assert math.sqrt(np.mean(np.square(list(errors.values())))) == pytest.approx(calibration.residual)


@pytest.mark.parametrize("places", [[0.0, 1.0], [0.0, 1.0, 2.0, 3.0]])
def test_too_few_markers_or_markers_on_a_line_are_refused(places: list[float]) -> None:
    line = {f"marker {i}": (place, 0.02 * (i % 2), 0.0) for i, place in enumerate(places)}
    with pytest.raises(CalibrationError, match="needs 3 markers" if len(places) < 3 else "lie on a line within 9 mm"):
        fit(line, line)


def test_a_z_up_stream_is_refused() -> None:
    with pytest.raises(CalibrationError, match=r"tilted by (90|120)°.*up axis to Y"):
        fit(KNOWN, KNOWN)


def test_a_position_without_value_is_refused() -> None:
    with pytest.raises(CalibrationError, match="not a number"):
        fit({**KNOWN, "right_hand": (math.nan, 0.0, 0.0)}, KNOWN)


def test_a_saved_calibration_is_read_back(tmp_path: Path) -> None:
    rotation = Rotation.from_euler("zyx", [0.3, 0.01, -0.02]).as_matrix()
    calibration = fit(seen_by_cameras(rotation, np.array([1.0, 2.0, 3.0])), KNOWN)
    calibration.save(tmp_path / "calibration.yaml")
    assert Calibration.load(tmp_path / "calibration.yaml") == calibration


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 2]]", "not a rotation matrix"),
        ("rotation: [[1, 0, 0], [0, 1, 0], [0, 0, -1]]", "not a rotation matrix"),
        ("rotation: [1, 2]", "is not a calibration"),
        ("{", "not YAML"),
        ("", "is not a calibration"),
    ],
)
def test_a_damaged_calibration_is_refused(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CalibrationError, match=reason):
        Calibration.load(path)


def test_a_missing_calibration_is_told(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="calibrate first"):
        Calibration.load(tmp_path / "none.yaml")


LIBEROBOT = body_of(config_for("mujoco").robot)
RACE_QUAD = NamedMarkers("RaceQuad", None, {"Marker1": 6, "Marker3": 7, "Marker5": 10})
ALL_OF_RACE_QUAD = NamedMarkers("RaceQuad", None, {f"Marker{place}": place for place in range(1, 6)})


def test_the_labels_of_liberobot_are_those_of_the_simulation() -> None:
    named = MarkerLabels().of(LIBEROBOT)
    assert (named.asset, named.model_id) == ("liberobot", None)
    assert named.markers == {marker.name: marker.marker_id for marker in LIBEROBOT.markers}


def test_the_labels_that_a_config_gives_replace_those_of_the_robot() -> None:
    given = MarkerLabels(asset="RaceQuad", model_id=2, markers={"Marker1": 6})
    assert given.of(LIBEROBOT) == NamedMarkers("RaceQuad", 2, {"Marker1": 6})


def test_labels_are_found_in_the_models_of_the_real_system() -> None:
    assert find_labels(RACE_QUAD, recording().definitions) == {(2, 1): 6, (2, 3): 7, (2, 5): 10}


BODY = m.RigidBodyDefinition("body", 7, markers=(m.BodyMarkerDefinition((0, 0, 0), 0, "left"),))
SET = m.MarkerSetDefinition("set", ("head", "left"))


@pytest.mark.parametrize(
    ("asset", "definitions", "model_id", "expected"),
    [
        ("body", (BODY,), None, (7, 1)),
        ("set", (SET,), 9, (9, 2)),
        ("set", (SET, m.SkeletonDefinition("set", 4, ())), None, (4, 2)),
        (
            "asset",
            (m.AssetDefinition("asset", 1, 5, (), (m.AssetMarkerDefinition("left", 12, (0, 0, 0)),)),),
            None,
            (5, 12),
        ),
    ],
)
def test_every_kind_of_asset_has_labels(
    asset: str, definitions: tuple[m.Definition, ...], model_id: int | None, expected: tuple[int, int]
) -> None:
    config = NamedMarkers(asset, model_id, {"left": 7})
    assert find_labels(config, m.ModelDefinitions(definitions)) == {expected: 7}


@pytest.mark.parametrize(
    ("config", "reason"),
    [
        (MarkerLabels(asset="RaceQuat"), "no asset 'RaceQuat'; did you mean 'RaceQuad'"),
        (MarkerLabels(asset="RaceQuad", markers={"Marker9": 1}), "no marker 'Marker9'; did you mean 'Marker"),
        (MarkerLabels(asset="all", markers={"RaceQuad_1": 1}), r"does not tell the id .* set labels\.model_id"),
    ],
)
def test_labels_that_cannot_be_found_are_told(config: MarkerLabels, reason: str) -> None:
    with pytest.raises(NatNetError, match=reason):
        find_labels(config.of(LIBEROBOT), recording().definitions)


def test_a_mocap_message_holds_the_seen_markers_in_the_world() -> None:
    frame = m.Frame(
        number=5,
        timestamp=0.0,
        markers=(
            m.LabelledMarker(2, 1, (1.0, 2.0, 3.0)),
            m.LabelledMarker(2, 3, (1.0, 2.0, 3.0), flags=m.OCCLUDED),
            m.LabelledMarker(2, 5, (math.nan, 0.0, 0.0)),
            m.LabelledMarker(3, 1, (0.0, 0.0, 0.0)),
            m.LabelledMarker(0, 50007, (4.0, 5.0, 6.0), flags=m.UNLABELLED),
        ),
    )
    message = mocap_frame(frame, 1234, find_labels(RACE_QUAD, recording().definitions), Calibration())
    assert (message.utime, message.frame_number, message.num_markers) == (1234, 5, 2)
    assert [(marker.marker_id, marker.marker_position) for marker in message.markers] == [
        (6, [3.0, 1.0, 2.0]),
        (marker_t.UNLABELLED, [6.0, 4.0, 5.0]),
    ]
    message.encode()


REST_LABELS = {(1, 1): 6, (1, 2): 7}
REST_NAMES = {6: "right_hand", 7: "left_hand"}


def rest_frames(*places: tuple[tuple[float, float, float] | None, ...]) -> list[m.Frame]:
    """Return frames in which the markers are at these places; None is a marker that is not there."""
    return [
        m.Frame(number, 0.0, markers=tuple(m.LabelledMarker(1, i, p) for i, p in enumerate(frame, 1) if p is not None))
        for number, frame in enumerate(places)
    ]


def test_markers_at_rest_are_at_their_mean_places_of_the_frames_that_saw_them() -> None:
    frames = rest_frames(((1.0, 2.0, 3.0), (0.0, 0.0, 0.0)), ((1.001, 2.0, 3.0), None))
    found = rest_positions(frames, REST_LABELS, REST_NAMES, CalibrationLimits())
    assert found == {"right_hand": pytest.approx((1.0005, 2.0, 3.0)), "left_hand": (0.0, 0.0, 0.0)}


def test_markers_that_are_hidden_or_occluded_are_named() -> None:
    seen = rest_frames(*[((0.0, 0.0, 0.0), None)] * 10)
    with pytest.raises(CalibrationError, match=r"of 10 frames the cameras saw left_hand in 0; 50 % are needed"):
        rest_positions(seen, REST_LABELS, REST_NAMES, CalibrationLimits())
    guessed = m.Frame(0, 0.0, markers=tuple(m.LabelledMarker(1, i, (0.0, 0.0, 0.0), flags=m.OCCLUDED) for i in (1, 2)))
    with pytest.raises(CalibrationError, match=r"saw right_hand in 0, left_hand in 4; "):
        rest_positions(
            [*[guessed] * 6, *rest_frames(*[(None, (0.0, 0.0, 0.0))] * 4)], REST_LABELS, REST_NAMES, CalibrationLimits()
        )


def test_marker_that_moves_is_named() -> None:
    frames = rest_frames(*[((0.0, 0.0, 0.0), (0.0, 0.001 * i, 0.0)) for i in range(20)])
    with pytest.raises(CalibrationError, match=r"left_hand moved by 5\.8 mm .* let the robot rest"):
        rest_positions(frames, REST_LABELS, REST_NAMES, CalibrationLimits())


def test_the_real_system_can_be_calibrated_with_its_rigid_body() -> None:
    labels = find_labels(ALL_OF_RACE_QUAD, recording().definitions)
    names = {label: name for name, label in ALL_OF_RACE_QUAD.markers.items()}
    seen = rest_positions(frames()[:1], labels, names, CalibrationLimits())
    body = frames()[0].rigid_bodies[0]
    definition = recording().definitions.definitions[0]
    assert isinstance(definition, m.RigidBodyDefinition)
    # Where the model says that its markers are, in a world whose origin is the body; the axes are Motive's, turned.
    # This system's models have x the other way round than its frames.
    offsets = np.array([marker.position for marker in definition.markers]) * (-1.0, 1.0, 1.0)
    places = Rotation.from_quat(body.quaternion).apply(offsets) @ Z_UP.T
    known = {names[label]: tuple(places[marker_id - 1]) for (_, marker_id), label in labels.items()}
    calibration = fit(seen, known)
    assert calibration.residual < 0.002
    np.testing.assert_allclose(calibration.rotation, Z_UP, atol=0.02)
    np.testing.assert_allclose(calibration.translation, -Z_UP @ body.position, atol=0.02)
