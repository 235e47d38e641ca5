"""Collision meshes: the convex hull of what an STL or OBJ file holds, so that every engine means the same body."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from imolo.contracts.engine import Array
from imolo.errors import BackendError

PACKAGE = "package://"
BINARY_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
STL_HEADER = 84  # [bytes] of which the last four are the number of triangles


@dataclass(frozen=True)
class Mesh:
    """A convex hull.

    Attributes:
        file: Where it comes from.
        scale: Factors along x, y, z that are already in the vertices [-].
        vertices: Corners of the hull in the frame of its shape [m], shape (V, 3).
        faces: Triangles as indices of the vertices, counterclockwise as seen from outside, shape (F, 3).
    """

    file: Path
    scale: tuple[float, float, float]
    vertices: Array
    faces: Array

    def write_obj(self, path: Path) -> None:
        """Write the hull as a Wavefront OBJ file."""
        rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in self.vertices.tolist()]
        rows += [f"f {a} {b} {c}" for a, b, c in (self.faces + 1).tolist()]
        path.write_text("\n".join(rows) + "\n")


def find_mesh(name: str, folder: Path) -> Path:
    """Return the file that a URDF in this folder calls by this name.

    `package://NAME/...` is NAME/... in the URDF's folder or the nearest folder above it that has such a file; other
    names are paths, relative ones from the URDF's folder.

    Raises:
        BackendError: There is no such file.
    """
    relative = name.removeprefix(PACKAGE).removeprefix("file://")
    folders = [folder, *folder.parents] if name.startswith(PACKAGE) else [folder]
    for place in folders:
        if (place / relative).is_file():
            return place / relative
    above = " or in a folder above it" if len(folders) > 1 else ""
    raise BackendError(f"mesh {name!r} is not in {folder}{above}; put {relative!r} there")


def read_hull(path: Path, scale: tuple[float, float, float]) -> Mesh:
    """Read the convex hull of a mesh.

    Args:
        path: An STL (binary or text) or OBJ file.
        scale: Factors along x, y, z [-].

    Raises:
        BackendError: The file cannot be read, or its points span no volume.
    """
    return _read_hull(path, scale, path.stat().st_mtime_ns)


@lru_cache(maxsize=256)
def _read_hull(path: Path, scale: tuple[float, float, float], _: int) -> Mesh:
    from scipy.spatial import ConvexHull, QhullError

    points = _read_points(path) * scale
    if len(points) == 0 or not np.isfinite(points).all():
        raise BackendError(f"mesh {path} has no points or some that are not numbers; export it again")
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        raise BackendError(f"mesh {path} spans no volume; use a <box>, or a mesh that is not flat") from None
    corners = np.unique(hull.simplices)
    faces = np.searchsorted(corners, hull.simplices)
    vertices: Array = points[corners]
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inwards] = faces[inwards][:, ::-1]
    for array in (vertices, faces):
        array.flags.writeable = False
    return Mesh(path, scale, vertices, faces)


def _read_points(path: Path) -> Array:
    data = path.read_bytes()
    match path.suffix.lower():
        case ".obj":
            return _parse_points(path, data, "v")
        case ".stl":
            # A binary file may begin with "solid" as well; its length tells.
            count = int.from_bytes(data[STL_HEADER - 4 : STL_HEADER], "little")
            if len(data) == STL_HEADER + count * BINARY_STL.itemsize:
                corners = np.frombuffer(data, BINARY_STL, offset=STL_HEADER)["corners"]
                return corners.reshape(-1, 3).astype(np.float64)
            return _parse_points(path, data, "vertex")
        case other:
            raise BackendError(f"mesh {path} is of kind {other!r}; convert it to .stl or .obj")


def _parse_points(path: Path, data: bytes, keyword: str) -> Array:
    words: Iterable[list[str]] = map(str.split, data.decode(errors="replace").splitlines())
    try:
        rows = [[float(x) for x in row[1:4]] for row in words if row and row[0] == keyword]
        return np.array(rows, dtype=np.float64).reshape(-1, 3)
    except ValueError:
        raise BackendError(
            f"mesh {path} is damaged: a {keyword!r} line has not three numbers; export it again"
        ) from None
