"""The robot is the paper's, and it starts where the paper puts it."""

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from liberobot import BODY, CONFIG, ready_scene
from scipy.spatial.transform import Rotation

from imolo.config.loading import body_of, config_for
from imolo.contracts.engine import Array, Scene
from imolo.contracts.robot import Body, Effector, Foot, Marker
from imolo.contracts.urdf import CollisionShape, read_urdf
from imolo.errors import BackendError
from imolo_robots.liberobot.body import (
    BOX_HEIGHT,
    FOOT_LINKS,
    HAND_OFFSET,
    JOINT_NAMES,
    LINK_NAMES,
    MARKERS,
    SOLE_RADIUS,
    TOE_OFFSET,
    TOE_TO_EDGE,
    URDF,
    with_flat_sole,
)

JOINT_LIMITS = BODY.joint_limits
MODEL = read_urdf(URDF)
INWARDS = np.array([-1.0] * 6 + [1.0] * 2)


def poses(scene: Scene) -> dict[str, tuple[Array, Array]]:
    w, x, y, z = scene.base_quaternion
    rotation = Rotation.from_quat([x, y, z, w]).as_matrix()
    angles = dict(zip(scene.joint_names, scene.joint_angle, strict=True))
    return read_urdf(scene.urdf).link_poses(angles, np.array(scene.base_position), rotation)


def standing(**angles: float) -> dict[str, tuple[Array, Array]]:
    return MODEL.link_poses(angles, np.zeros(3), np.eye(3))


def lowest_foot_point(scene: Scene) -> float:
    model, where = read_urdf(scene.urdf), poses(scene)
    return min(shape.lowest_point(*where[foot]) for foot in FOOT_LINKS for shape in model.links[foot].collisions)


def center_of_mass(scene: Scene) -> Array:
    where = poses(scene)
    parts = [link.mass * (where[name][0] + where[name][1] @ link.com) for name, link in MODEL.links.items()]
    return np.asarray(np.sum(parts, axis=0) / MODEL.mass)


def test_mass_height_and_width_are_the_papers() -> None:
    assert MODEL.mass == pytest.approx(7.4)
    where = standing()
    trunk = MODEL.links["trunk"].collisions[0]
    top = trunk.position[2] + 0.5 * trunk.size[2]
    bottom = min(shape.lowest_point(*where[foot]) for foot in FOOT_LINKS for shape in MODEL.links[foot].collisions)
    assert top - bottom == pytest.approx(1.163)
    plate = MODEL.links["left_arm"].collisions[1]
    assert 2.0 * (where["left_arm"][0][1] + 0.5 * plate.size[1]) == pytest.approx(0.400)
    assert sorted(plate.size) == pytest.approx([0.003, 0.080, 0.300])


def test_segment_lengths_are_the_papers() -> None:
    where = standing()
    height = {name: where[name][0][2] for name in LINK_NAMES}
    assert height["left_arm"] - height["trunk"] == pytest.approx(0.446)
    assert height["left_thigh"] - height["left_shank"] == pytest.approx(0.290)
    assert height["left_shank"] - height["left_foot"] == pytest.approx(0.310)
    heel, toe = MODEL.links["left_foot"].collisions
    assert toe.position[0] - heel.position[0] == pytest.approx(0.211)
    assert {heel.size, toe.size} == {(SOLE_RADIUS,)}


def test_joints_and_links_are_in_the_canonical_order() -> None:
    assert tuple(MODEL.joints) == JOINT_NAMES
    assert set(MODEL.links) == set(LINK_NAMES)
    assert MODEL.base == LINK_NAMES[0]
    assert np.degrees(JOINT_LIMITS).round(9).tolist() == [[0, 150], [0, 150], [-45, 45]] * 2 + [[0, 150]] * 2


def test_nothing_but_the_stops_restrains_a_joint() -> None:
    for joint in ElementTree.parse(URDF).getroot().findall("joint"):
        limit, dynamics = joint.find("limit"), joint.find("dynamics")
        assert limit is not None
        assert dynamics is not None
        assert min(float(limit.attrib["effort"]), float(limit.attrib["velocity"])) >= 1e6
        assert float(dynamics.attrib["damping"]) == float(dynamics.attrib["friction"]) == 0.0


def test_positive_angles_bend_the_legs_lift_the_toes_and_raise_the_arms() -> None:
    rest = standing()
    assert standing(left_hip=0.5)["left_shank"][0][0] > rest["left_shank"][0][0]
    assert standing(left_knee=0.5)["left_foot"][0][0] < rest["left_foot"][0][0]
    assert (standing(left_ankle=0.5)["left_foot"][1] @ TOE_OFFSET)[2] > 0.0
    hand = standing(left_shoulder=np.pi / 2)["left_arm"][1] @ HAND_OFFSET
    assert hand == pytest.approx([0.35, 0.0, 0.0])


def test_the_left_side_mirrors_the_right() -> None:
    for name, link in MODEL.links.items():
        if name.startswith("right_"):
            twin = MODEL.links[name.replace("right", "left")]
            assert twin.mass == link.mass
            assert np.array_equal(twin.inertia, link.inertia)
            assert np.array_equal(twin.com, link.com)
            assert standing()[twin.name][0] == pytest.approx(standing()[name][0] * [1, -1, 1])


def test_a_rigid_body_could_have_these_inertias() -> None:
    for link in MODEL.links.values():
        a, b, c = np.linalg.eigvalsh(link.inertia)
        assert a > 0.0
        assert a + b >= c


def test_the_ready_pose_stands_on_the_box_behind_its_edge() -> None:
    scene = ready_scene()
    where = poses(scene)
    assert lowest_foot_point(scene) == pytest.approx(BOX_HEIGHT, abs=1e-12)
    for foot in FOOT_LINKS:
        position, rotation = where[foot]
        assert rotation == pytest.approx(np.eye(3), abs=1e-12)
        assert (position + rotation @ TOE_OFFSET)[0] == pytest.approx(-TOE_TO_EDGE)
    assert 2.0 * np.arctan2(scene.base_quaternion[2], scene.base_quaternion[0]) == pytest.approx(np.radians(45.0))
    (box,) = scene.boxes
    assert box.center[0] + box.half_extents[0] == pytest.approx(0.0)
    assert box.center[2] + box.half_extents[2] == pytest.approx(BOX_HEIGHT)


def test_the_ready_pose_is_balanced() -> None:
    center = center_of_mass(ready_scene())
    heel, toe = -TOE_TO_EDGE - 0.211, -TOE_TO_EDGE
    assert heel + 0.03 < center[0] < toe - 0.03
    assert center[1] == pytest.approx(0.0, abs=1e-12)


@settings(deadline=None, max_examples=50)
@given(st.lists(st.floats(0.0, 0.3), min_size=8, max_size=8))
def test_a_perturbed_pose_still_touches_the_box(size: list[float]) -> None:
    scene = ready_scene(INWARDS * size)
    assert lowest_foot_point(scene) == pytest.approx(BOX_HEIGHT, abs=1e-12)
    toes = [position[0] + (rotation @ TOE_OFFSET)[0] for position, rotation in (poses(scene)[f] for f in FOOT_LINKS)]
    assert np.mean(toes) == pytest.approx(-TOE_TO_EDGE)


def test_equal_offsets_of_both_legs_leave_the_feet_level() -> None:
    scene = ready_scene(INWARDS * [0.1, 0.2, 0.05, 0.1, 0.2, 0.05, 0.0, 0.0])
    assert poses(scene)["left_foot"][1] == pytest.approx(np.eye(3), abs=1e-12)


def test_offsets_beyond_a_limit_are_refused() -> None:
    with pytest.raises(BackendError, match=r"left_knee cannot start at 151\.000°; its range is 0\.000° to 150\.000°"):
        ready_scene([0.0] * 4 + [np.radians(1.0)] + [0.0] * 3)
    with pytest.raises(BackendError, match=r"shape \(7,\); expected \(8,\)"):
        ready_scene([0.0] * 7)


def test_the_flat_sole_changes_nothing_but_the_shape(tmp_path: Path) -> None:
    flat = read_urdf(with_flat_sole(URDF, tmp_path / "flat.urdf"))
    for foot in FOOT_LINKS:
        (sole,) = flat.links[foot].collisions
        assert sole.kind == "box"
        assert sole.size[:2] == pytest.approx((0.211, 0.096))
        assert sole.position[2] - 0.5 * sole.size[2] == pytest.approx(-SOLE_RADIUS)
        assert sole.position[2] + 0.5 * sole.size[2] < 0.0
    assert flat.joints.keys() == MODEL.joints.keys()
    for name, link in flat.links.items():
        assert link.mass == MODEL.links[name].mass
        assert np.array_equal(link.inertia, MODEL.links[name].inertia)
        if name not in FOOT_LINKS:
            assert len(link.collisions) == len(MODEL.links[name].collisions)


def test_the_flat_soled_robot_starts_where_the_round_soled_one_does() -> None:
    flat_robot = config_for("mujoco", robot={"sole": "flat"}).robot
    flat, semicircular = ready_scene(body=body_of(flat_robot)), ready_scene()
    assert replace(flat, urdf=URDF) == semicircular
    assert lowest_foot_point(flat) == pytest.approx(BOX_HEIGHT)
    with pytest.raises(BackendError, match="no round sole"):
        with_flat_sole(flat.urdf, flat.urdf.with_name("twice.urdf"))


def test_markers_have_their_own_labels_and_the_hand_is_the_middle_of_the_plate() -> None:
    assert len({marker.marker_id for marker in MARKERS}) == len({marker.name for marker in MARKERS}) == len(MARKERS)
    assert {marker.link for marker in MARKERS} <= set(LINK_NAMES)
    for effector in BODY.effectors:
        plate = MODEL.links[effector.link].collisions[1]
        (middle,) = (marker for marker in MARKERS if marker.name == effector.name)
        assert (middle.link, middle.offset) == (effector.link, tuple(plate.position))
        assert effector.width == sorted(plate.size)[1]
        # From the shoulder to the end of the plate.
        assert effector.limb_length == pytest.approx(0.5 * plate.size[2] - plate.position[2])


def test_the_right_hand_learns() -> None:
    assert [effector.name for effector in BODY.effectors] == ["right_hand", "left_hand"]
    assert BODY.learning_marker == BODY.effector_marker(0) == 6
    assert BODY.effector_marker(1) == 7


def test_ready_markers_are_where_the_scene_has_their_links() -> None:
    where = poses(ready_scene())
    for marker in MARKERS:
        position, rotation = where[marker.link]
        assert BODY.ready_markers()[marker.name] == pytest.approx(position + rotation @ marker.offset, abs=1e-12)


def test_defaults_are_those_of_the_paper() -> None:
    assert CONFIG.robot.name == "liberobot"
    assert CONFIG.task.name == "hit"
    assert list(CONFIG.methods) == ["paper", "improved"]
    assert CONFIG.training.comparison_time == 0.17


@pytest.mark.parametrize(
    ("kind", "size", "reach"),
    [("sphere", (0.2,), 0.2), ("box", (0.2, 0.4, 0.6), 0.3), ("cylinder", (0.1, 0.8), 0.4)],
)
def test_the_lowest_point_of_a_shape_is_its_reach_below_the_center(
    kind: str, size: tuple[float, ...], reach: float
) -> None:
    shape = CollisionShape(kind, size, np.array([0.0, 0.0, 1.0]), np.eye(3))  # type: ignore[arg-type]
    assert shape.lowest_point(np.zeros(3), np.eye(3)) == pytest.approx(1.0 - reach)
    # Tilted by 45° about y, corners and edges point down.
    tilted = shape.lowest_point(np.zeros(3), Rotation.from_euler("y", np.pi / 4).as_matrix())
    half = {"sphere": 0.2, "box": (0.1 + 0.3) / np.sqrt(2), "cylinder": (0.1 + 0.4) / np.sqrt(2)}[kind]
    assert tilted == pytest.approx(np.cos(np.pi / 4) - half)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<mass value="0.2"/>', '<mass value="0"/>', "mass 0.0 kg"),
        ("<sphere radius", "<plane radius", "<plane> is not supported"),
        ('type="revolute"', 'type="planar"', "is 'planar'"),
        ("</robot>", "", "cannot read URDF"),
        ('<child link="left_arm"/>', '<child link="right_arm"/>', "exactly one base link"),
    ],
)
def test_a_urdf_that_cannot_be_used_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = URDF.read_text()
    assert old in text
    path = tmp_path / "robot.urdf"
    path.write_text(text.replace(old, new))
    with pytest.raises(BackendError, match=message):
        _ = read_urdf(path).base


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joint_names": ("left_hipp",)}, r"joint 'left_hipp' is not in liberobot\.urdf; did you mean 'left_hip'"),
        (
            {"markers": (*MARKERS, Marker(12, "nose", "head"))},
            r"link of marker 'nose', 'head' is not in liberobot\.urdf.*known: .*trunk",
        ),
        ({"effectors": (Effector("right_hand", "arm", 0.1),)}, "link of effector 'right_hand', 'arm' is not in"),
        ({"effectors": (Effector("racket", "right_arm", 0.1),)}, "marker of an effector, 'racket' is not in"),
        ({"feet": (Foot("left_fot", 0.0),)}, "link of foot, 'left_fot' is not in .*did you mean 'left_foot'"),
        ({"effectors": ()}, "has no effector; name the link that is to meet the ball"),
        ({"markers": (*MARKERS, Marker(3, "nose", "trunk"))}, "marker id 3 is negative or used twice"),
        ({"markers": (*MARKERS, Marker(-1, "nose", "trunk"))}, "marker id -1 is negative or used twice"),
        ({"mirrored_joints": {"left_hip": "right_hp"}}, "mirrored joint 'right_hp' is not in .*mean 'right_hip'"),
        ({"ready": (0.0,) * 7}, "the ready pose has 7 angles for 8 joints"),
    ],
)
def test_a_body_that_does_not_fit_its_urdf_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(BackendError, match=message) as caught:
        replace(BODY, **change)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_a_body_takes_from_its_urdf_what_is_not_given() -> None:
    plain = Body("plain", URDF, MARKERS, BODY.effectors)
    assert plain.joint_names == JOINT_NAMES
    assert plain.link_names[0] == LINK_NAMES[0]
    assert set(plain.link_names) == set(LINK_NAMES)
    assert plain.ready == (0.0,) * 8


def test_feet_are_told_by_the_markers_at_their_origins() -> None:
    assert BODY.standing_markers == {2: SOLE_RADIUS, 5: SOLE_RADIUS}
