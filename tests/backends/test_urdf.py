"""What a URDF may hold, and the one line that it gets for what it may not."""

from pathlib import Path
from struct import pack

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imolo.contracts.mesh import find_mesh, read_hull
from imolo.contracts.urdf import CollisionShape, read_urdf
from imolo.errors import BackendError

CORNERS = np.array([[x, y, z] for x in (0.0, 2.0) for y in (0.0, 3.0) for z in (0.0, 4.0)])
INSIDE = np.array([[1.0, 1.0, 1.0]])
TRIANGLES = [(0, 1, 2), (3, 4, 5), (5, 6, 7), (0, 7, 1)]  # every corner is in one; the hull is that of all
UNIT = (1.0, 1.0, 1.0)
URDF = """<robot name="two">
<link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>
<link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>
<collision><geometry><box size="1 1 1"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1"/></joint></robot>"""


def write_obj(path: Path) -> None:
    path.write_text("# box\no box\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in (*CORNERS, *INSIDE)) + "f 1 2 3\n")


def write_text_stl(path: Path) -> None:
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n" + "".join(f"vertex {x} {y} {z}\n" for x, y, z in CORNERS[list(triangle)])
        + "endloop\nendfacet\n" for triangle in TRIANGLES
    )  # fmt: skip
    path.write_text(f"solid box\n{facets}endsolid box\n")


def write_binary_stl(path: Path) -> None:
    triangles = [pack("<12fH", 0, 0, 0, *CORNERS[list(triangle)].ravel(), 0) for triangle in TRIANGLES]
    # A header that a text file could have.
    path.write_bytes(b"solid box".ljust(80) + pack("<I", len(triangles)) + b"".join(triangles))


@pytest.mark.parametrize(
    ("name", "write"), [("a.obj", write_obj), ("a.stl", write_text_stl), ("A.STL", write_binary_stl)]
)
def test_a_mesh_is_its_hull_with_faces_that_look_outwards(tmp_path: Path, name: str, write: object) -> None:
    write(tmp_path / name)  # type: ignore[operator]
    mesh = read_hull(tmp_path / name, (0.5, 1.0, 1.0))
    assert {tuple(corner) for corner in mesh.vertices} == {tuple(corner) for corner in CORNERS * [0.5, 1.0, 1.0]}
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    # The divergence theorem: outward faces span the volume.
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0 == pytest.approx(1.0 * 3.0 * 4.0)


def test_a_hull_that_is_written_is_read_again(tmp_path: Path) -> None:
    write_obj(tmp_path / "a.obj")
    mesh = read_hull(tmp_path / "a.obj", UNIT)
    mesh.write_obj(tmp_path / "b.obj")
    assert np.array_equal(read_hull(tmp_path / "b.obj", UNIT).vertices, mesh.vertices)


def test_the_lowest_point_of_a_mesh_is_its_lowest_corner(tmp_path: Path) -> None:
    write_obj(tmp_path / "a.obj")
    mesh = read_hull(tmp_path / "a.obj", UNIT)
    turn = Rotation.from_euler("xyz", [0.3, -0.8, 0.2]).as_matrix()
    shape = CollisionShape("mesh", (), np.array([0.1, 0.2, 0.3]), turn, mesh)
    pose = Rotation.from_euler("xyz", [-1.2, 0.4, 2.0]).as_matrix()
    heights = [(pose @ (shape.position + turn @ corner))[2] for corner in CORNERS]
    assert shape.lowest_point(np.array([0.0, 0.0, 5.0]), pose) == pytest.approx(5.0 + min(heights))


@pytest.mark.parametrize("name", ["a.obj", "meshes/a.obj", "package://robot/meshes/a.obj", "package://meshes/a.obj"])
def test_meshes_are_found_beside_the_urdf_and_in_packages_above_it(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "robot" / "urdf"
    file = {"a.obj": folder, "meshes/a.obj": folder / "meshes"}.get(name, folder.parent / "meshes") / "a.obj"
    file.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    write_obj(file)
    assert find_mesh(name, folder).samefile(file)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.dae", "", "of kind '.dae'; convert it to .stl or .obj"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\n", "spans no volume; use a <box>"),
        ("a.obj", "v 1 2\n", "'v' line has not three numbers"),
        ("a.obj", "v nan 0 0\n", "no points or some that are not numbers"),
        ("a.stl", "", "no points"),
    ],
)
def test_a_mesh_that_cannot_be_used_is_refused(tmp_path: Path, name: str, content: str, message: str) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(BackendError, match=message):
        read_hull(tmp_path / name, UNIT)


BOX = '<box size="1 1 1"/>'


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<child link="arm"/>', '<child link="arms"/>', "link 'arms', which is not there; did you mean 'arm'"),
        ('<link name="arm">', '<link name="base">', "two of its links are named 'base'; rename one"),
        ('xyz="0 0 1"', 'xyz="0 0 0"', "joint 'turn' has the axis 0 0 0"),
        ('xyz="0 0 1"', 'xyz="0 1"', "xyz='0 1' of a <axis>; expected 3 numbers"),
        ('lower="-1"', 'lower="1"', r"limits \(1.0, 1.0\); the lower comes first"),
        ('lower="-1"', 'lower="x"', "lower='x' of a <limit>; expected 1 numbers"),
        ('mass value="1"', 'mass value="-1"', "link 'base' has mass -1.0 kg"),
        ('izz="1"', 'izz="-1"', "principal moments .*; all must be positive"),
        ('type="revolute"', 'type="ball"', "joint 'turn' is 'ball'; use revolute, continuous, prismatic, fixed"),
        ('"base"', '"world"', "link 'world' has a mass, shapes or joints that move"),
        (BOX, "<capsule/>", "<capsule> is not supported; use box, sphere, cylinder or mesh"),
        (BOX, '<mesh filename="package://no/a.stl"/>', "'package://no/a.stl' is not in .* or in a folder above it"),
        ("</geometry>", "</geometry><no/>", None),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_urdf_is_said_in_one_line(tmp_path: Path, old: str, new: str, message: str | None) -> None:
    assert old in URDF
    path = tmp_path / "robot.urdf"
    path.write_text(URDF.replace(old, new))
    if message is None:
        assert set(read_urdf(path).links) == {"base", "arm"}
        return
    with pytest.raises(BackendError, match=rf"^URDF robot.urdf: .*{message}") as error:
        read_urdf(path)
    assert "\n" not in str(error.value)


def test_a_moment_of_inertia_that_no_body_has_is_cut(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(URDF.replace('izz="1"', 'izz="2.5"'))
    assert np.diag(read_urdf(path).links["arm"].inertia) == pytest.approx([1.0, 1.0, 2.0], rel=1.1e-5)
    assert "link 'arm' has principal moments [1.0, 1.0, 2.5] kg m², which no body has; the last is cut" in caplog.text


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ('<link name="arm"><inertial><mass value="1"/>', '<link name="arm"><inertial>', ("link 'arm'", "<mass>")),
        ('<inertia ixx="1" iyy="1" izz="1"/></inertial>\n<coll', "</inertial><coll", ("link 'arm'", "<inertia>")),
        ('<geometry><box size="1 1 1"/></geometry>', "", ("link 'arm'", "<geometry>")),
        ('<box size="1 1 1"/>', '<box size="1 1"/>', ("link 'arm'", "size='1 1'")),
        ('<box size="1 1 1"/>', "<capsule/>", ("link 'arm'", "capsule")),
        ('<parent link="base"/>', "", ("joint 'turn'", "<parent>")),
        ('<limit lower="-1" upper="1"/>', "", ("joint 'turn'", "<limit>")),
        ('<axis xyz="0 0 1"/>', '<axis xyz="up"/>', ("joint 'turn'", "xyz='up'")),
    ],
)
def test_what_is_wrong_in_a_link_or_joint_is_told_with_its_name(
    tmp_path: Path, old: str, new: str, parts: tuple[str, ...]
) -> None:
    assert URDF.count(old) == 1
    (tmp_path / "two.urdf").write_text(URDF.replace(old, new), encoding="utf-8")
    with pytest.raises(BackendError) as caught:
        read_urdf(tmp_path / "two.urdf")
    assert str(caught.value).startswith("URDF two.urdf: ")
    assert all(part in str(caught.value) for part in parts), caught.value
    assert "None" not in str(caught.value)


def test_joint_that_is_to_mimic_another_is_named_in_one_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text = URDF.replace("</joint>", '<mimic joint="wrist"/></joint>').replace('"turn"', '"finger of one test"')
    (tmp_path / "two.urdf").write_text(text, encoding="utf-8")
    for _ in range(2):  # once only
        read_urdf(tmp_path / "two.urdf")
    (told,) = caplog.messages
    assert told.startswith("joint 'finger of one test' is to mimic 'wrist', ")
    assert "\n" not in told
