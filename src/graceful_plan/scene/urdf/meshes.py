"""Mesh files named by a URDF: their location, and their content in a format that MuJoCo reads."""

from __future__ import annotations

import importlib
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import READ_ERRORS, SceneError, UnsupportedError, read_error_reason
from graceful_plan.regular_file import read_content
from graceful_plan.scene.loading.weighing import MOST_OF_A_MESH, mesh_weight

_MOST_BYTES = 100_000_000
_READ = (".stl", ".obj")
"""Formats that MuJoCo reads; `.dae` is converted."""


def found_mesh(name: str, folder: Path | None, packages: Sequence[Path] | Mapping[str, Path]) -> Path:
    """Return the mesh file that a URDF refers to.

    Args:
        name: "package://PACKAGE/FILE", "file:///FILE", or a path relative to the URDF's folder.
        folder: Folder of the URDF, if it is a file.
        packages: Folders that are or contain packages, or package folders by package name. The folders above the URDF
            are searched for packages as well.

    Returns:
        A file in a package, in the folder of the URDF or its package, or in `packages`; others are not read.

    Raises:
        SceneError: If there is no such file; the message says what to give.
    """
    kind, _, rest = name.rpartition("://")
    rest = unquote(rest)
    if kind not in ("package", "file", ""):
        raise SceneError(f"the mesh {name[:200]!r} is not a file, which may be package://, file:// or a path")
    if "\0" in rest:
        raise SceneError(f"the mesh {name[:200]!r} was not found: no file has a null character in its name")
    if kind == "package":
        package, _, inside = rest.partition("/")
        above = [] if folder is None else list(folder.parents)
        if isinstance(packages, Mapping):
            tried = [*_inside(packages[package], inside)] if package in packages else []
            wanted = f"packages={{{package[:100]!r}: its folder}}"
        else:
            tried = [place for root in packages for place in _places(root, package, inside)]
            wanted = "packages=[folder that has this package in it]"
        tried += [place for root in above for place in _places(root, package, inside)]
    else:
        given = list(packages.values() if isinstance(packages, Mapping) else packages)
        starts, allowed = ([], given) if folder is None else ([folder], [folder, *_own_package(folder), *given])
        tried = [start / rest for start in [*starts, *given] if kind != "file" or Path(rest).is_absolute()]
        outside = [place for place in tried if not any(_is_inside(place, root) for root in allowed)]
        if tried and len(outside) == len(tried):
            raise SceneError(
                f"the mesh {name[:200]!r} is outside of the folder of the URDF and of its package; allow its folder by"
                " packages=[FOLDER]"
            )
        tried = [place for place in tried if place not in outside]
        wanted = "the file there" if allowed else "packages=[folder of the meshes]"
    for place in tried:
        if _is_file(place):
            return place
    raise SceneError(f"the mesh {name[:200]!r} was not found; give {wanted}")


def _is_file(place: Path) -> bool:
    try:
        return place.is_file()
    except READ_ERRORS:  # for example a name that is too long
        return False


def _places(root: Path, package: str, inside: str) -> Iterable[Path]:
    """Yield possible paths of a file of a package; paths outside the package are skipped."""
    for folder in (root / package, *([root] if root.name == package else [])):
        yield from _inside(folder, inside)


def _inside(folder: Path, inside: str) -> Iterable[Path]:
    place = folder / inside
    if _is_inside(place, folder):
        yield place


def _is_inside(place: Path, folder: Path) -> bool:
    """Return whether a path, with symbolic links followed, is in a folder."""
    return place.resolve().is_relative_to(folder.resolve())


def _own_package(folder: Path) -> list[Path]:
    """Return the folder of the ROS package that contains a folder; none if it is in no package."""
    return [above for above in (folder, *folder.parents) if _is_file(above / "package.xml")][:1]


def mesh_content(file: Path) -> tuple[bytes, str]:
    """Return the content of a mesh file and its suffix, converted if MuJoCo does not read the format.

    Raises:
        SceneError: If it cannot be read.
        UnsupportedError: If the format is unknown, or the library for its conversion is missing.
    """
    ending = file.suffix.lower()
    if ending not in (*_READ, ".dae"):
        raise UnsupportedError(f"{file}: meshes may be .stl, .obj or .dae")
    try:
        content = read_content(file, _MOST_BYTES)
    except READ_ERRORS as error:
        raise SceneError(read_error_reason(error), file=str(file)) from None
    if ending == ".dae":
        return _converted(file, content), ".obj"
    if (weight := mesh_weight(content, ending)) > MOST_OF_A_MESH:
        raise SceneError(f"{weight} vertices and faces; at most {MOST_OF_A_MESH} are read", file=str(file))
    if ending == ".stl" and _is_text(content):
        return _obj(_corners(content, file)), ".obj"
    return content, ending


def mesh_triangles(content: bytes, ending: str, name: str) -> Float[Array, "triangle 3 3"]:
    """Return the triangles of the content from `mesh_content` [m, before scaling].

    Raises:
        SceneError: If the content is broken.
    """
    triangles = _binary_triangles(content) if ending == ".stl" else _obj_triangles(content)
    if triangles is None or not len(triangles) or not np.isfinite(triangles).all():
        raise SceneError(f"the mesh {name!r} has no triangles that can be read")
    return triangles


def _binary_triangles(content: bytes) -> Float[Array, "triangle 3 3"] | None:
    count = int.from_bytes(content[80:84], "little")
    if len(content) < _binary_size(content):
        return None
    records = np.frombuffer(content, dtype=np.dtype((np.void, 50)), count=count, offset=84)
    floats = np.frombuffer(records.tobytes(), dtype=np.uint8).reshape(count, 50)[:, 12:48]
    return np.ascontiguousarray(floats).view("<f4").reshape(count, 3, 3).astype(float)


def _obj_triangles(content: bytes) -> Float[Array, "triangle 3 3"] | None:
    corners, faces = [], []
    try:
        for line in content.decode("utf-8", "replace").splitlines():
            kind, *rest = line.split() or [""]
            if kind == "v":
                corners.append([float(x) for x in rest[:3]])
            elif kind == "f":
                index = [int(word.split("/")[0]) for word in rest]
                at = [k - 1 if k > 0 else len(corners) + k for k in index]
                faces += [(at[0], at[k], at[k + 1]) for k in range(1, len(at) - 1)]
        return np.array(corners, dtype=float).reshape(-1, 3)[np.array(faces, dtype=int).reshape(-1, 3)]
    except (ValueError, IndexError):
        return None


def obj_content(triangles: Float[Array, "triangle 3 3"]) -> bytes:
    """Return triangles as the text of an OBJ file."""
    return _obj(triangles.reshape(-1, 3))


def _is_text(content: bytes) -> bool:
    """Return whether an STL file is in text form; some binary files begin with the same word."""
    return content[:5].lower() == b"solid" and b"facet" in content[:1000] and len(content) != _binary_size(content)


def _binary_size(content: bytes) -> int:
    return 84 + 50 * int.from_bytes(content[80:84], "little")


def _corners(content: bytes, file: Path) -> Float[Array, "corner 3"]:
    words = (line.split() for line in content.decode("ascii", "replace").splitlines() if "vertex" in line)
    try:
        corners = np.array([[float(x) for x in line[1:4]] for line in words])
    except ValueError as error:
        raise SceneError(f"not an STL file: {error}", file=str(file)) from None
    if corners.ndim != 2 or corners.shape[1] != 3 or len(corners) % 3:
        raise SceneError("not an STL file: its facets do not have three corners", file=str(file))
    return corners


def _obj(corners: Float[Array, "corner 3"]) -> bytes:
    """Return triangles as the text of an OBJ file."""
    text = io.StringIO()
    np.savetxt(text, corners, fmt="v %.9g %.9g %.9g")
    np.savetxt(text, np.arange(1, len(corners) + 1).reshape(-1, 3), fmt="f %d %d %d")
    return text.getvalue().encode()


def _converted(file: Path, content: bytes) -> bytes:
    try:
        trimesh = importlib.import_module("trimesh")
        importlib.import_module("collada")
    except ImportError:
        told = "COLLADA is read by trimesh and pycollada: pip install '.[urdf]'"
        raise UnsupportedError(f"{file}: {told}") from None
    try:
        mesh = trimesh.load(io.BytesIO(content), file_type="dae", force="mesh")
    except Exception as error:  # the library may raise anything on a broken file
        raise SceneError(f"not a COLLADA file that can be read: {error}", file=str(file)) from None
    return _obj(np.asarray(mesh.triangles, dtype=float).reshape(-1, 3))
