"""Conversion of a URDF to a MjSpec that can be placed in a world, with the data that MuJoCo omits.

MuJoCo reads links, inertias, joints, their ranges and efforts. It ignores velocity limits, and it looks for meshes by
bare file names. Only collision geometry is used.
"""

from __future__ import annotations

import copy
import logging
import re
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import mujoco
import numpy as np

from graceful_plan.exceptions import SceneError, UnknownNameError, UnsupportedError
from graceful_plan.scene.loading.weighing import mesh_weight
from graceful_plan.scene.urdf.convex_parts import convex_parts, part_triangles
from graceful_plan.scene.urdf.meshes import found_mesh, mesh_content, mesh_triangles, obj_content
from graceful_plan.scene.urdf.robot_xml import parsed_robot

_MOST_OF_MESHES = 2_000_000
"""Largest number of vertices and faces of all meshes together."""
_LOG = logging.getLogger(__name__)
_MOVING = ("revolute", "continuous", "prismatic")
_LEAST_INERTIA = 1e-7
"""Least principal moment of a link [kg m^2]: MuJoCo needs one, and links that are only sensor frames often lack it."""
_SETTINGS = {
    "fusestatic": "false",
    "strippath": "false",
    "balanceinertia": "true",
    "boundmass": "1e-4",
    "boundinertia": str(_LEAST_INERTIA),
}
"""Attributes of MuJoCo's compiler element."""
_ODD = re.compile(r"[^A-Za-z0-9_.-]")
_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


@final
@dataclass(frozen=True, kw_only=True)
class UrdfJoint:
    """A joint of a URDF.

    | field    | meaning                                              | unit           |
    |----------|------------------------------------------------------|----------------|
    | name     |                                                      |                |
    | kind     | "revolute", "continuous", "prismatic", "fixed", ...  |                |
    | parent   | link                                                 |                |
    | child    | link                                                 |                |
    | velocity | limit, infinite if not given                         | rad/s or m/s   |
    | position | lower and upper limit; None if it has none           | rad or m       |
    | mimic    | joint to follow, factor and offset; or None          |                |
    """

    name: str
    kind: str
    parent: str
    child: str
    velocity: float
    position: tuple[float, float] | None
    mimic: tuple[str, float, float] | None

    @property
    def is_movable(self) -> bool:
        """Whether it can be planned: a hinge or slide that mimics no other joint."""
        return self.kind in _MOVING and self.mimic is None


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class UrdfRobot:
    """A robot from URDF: its name, its joints, and a MjSpec whose bodies have the names of its links."""

    name: str
    joints: tuple[UrdfJoint, ...]
    spec: mujoco.MjSpec

    def movable(self, names: Collection[str]) -> list[UrdfJoint]:
        """Return those of the named joints that can be planned, in the order of the model."""
        known = {joint.name: joint for joint in self.joints if joint.is_movable}
        order = [joint.name for joint in self.spec.joints]
        return [known[name] for name in order if name in known and name in names]

    @property
    def limits(self) -> dict[str, tuple[float, float]]:
        """Lower and upper limit of each joint that has some, by its name in the URDF [rad or m]."""
        return {joint.name: joint.position for joint in self.joints if joint.position is not None}

    def check_link(self, link: str) -> None:
        """Check that a link exists.

        Raises:
            UnknownNameError: If it does not.
        """
        links = {end for joint in self.joints for end in (joint.parent, joint.child)}
        if link not in links:
            raise UnknownNameError("link of the tool", link, links)

    def chain(self, link: str) -> list[UrdfJoint]:
        """Return the joints that move a link, from the root on.

        Raises:
            UnknownNameError: If there is no such link.
            UnsupportedError: If such a joint mimics another, or is of a type that is not planned.
        """
        self.check_link(link)
        above = {joint.child: joint for joint in self.joints}
        found: list[UrdfJoint] = []
        while link in above:
            joint = above[link]
            if joint.kind not in (*_MOVING, "fixed") or joint.mimic is not None:
                kind = joint.kind if joint.mimic is None else "mimic"
                raise UnsupportedError(f"the {kind} joint {joint.name!r} is between the base and the tool")
            found += [joint] * (joint.kind in _MOVING)
            link = joint.parent
        return found[::-1]


Packages = Sequence[str | Path] | Mapping[str, str | Path]
"""Folders that are or contain packages, or package folders by package name."""


def read_urdf(
    source: str | Path, packages: Packages = (), *, decompose: bool | Collection[str] | None = False
) -> UrdfRobot:
    """Read a robot from URDF.

    Args:
        source: A file, or its text if it starts with "<".
        packages: Folders to resolve `package://`: packages, folders that contain packages, or folders by package name.
            Meshes are read only from there, from the folder of the file, and from the ROS package that it is in.
        decompose: Whether to divide meshes far from convex into parts; with None, only if the library is installed.
            Names of links divide their meshes alone, closely.

    Raises:
        UnknownNameError: If `decompose` names a link that the robot does not have.
        SceneError: If the URDF is broken, hostile, or has no collision geometry.
        UnsupportedError: If it has meshes that cannot be read.
    """
    root, folder = parsed_robot(source)
    meshes = {mesh.get("filename", "") for mesh in root.iterfind("link/collision/geometry/mesh")}
    if root.find("link/collision/geometry") is None:
        raise SceneError("no link has collision geometry", file=None if folder is None else str(source))
    if isinstance(decompose, Collection):
        of_links = _meshes_of(root, decompose)
        divided, closely = {mesh: mesh in of_links for mesh in meshes}, True
    else:
        divided, closely = dict.fromkeys(meshes, decompose), False
    assets: dict[str, bytes] = {}
    parts: dict[str, list[str]] = {}
    if isinstance(packages, Mapping):
        places = {package: Path(place) for package, place in packages.items()}
    else:
        places = [Path(place) for place in packages]
    weight = 0
    for k, name in enumerate(sorted(meshes)):
        content, ending = mesh_content(found_mesh(name, folder, places))
        weight += mesh_weight(content, ending)
        if weight > _MOST_OF_MESHES:
            raise SceneError(f"with the mesh {name[:200]!r} there are more than {_MOST_OF_MESHES} vertices and faces")
        found = _in_parts(content, ending, name, divided[name], closely=closely)
        stem = _ODD.sub("_", Path(name).stem)[:60]  # for messages about the mesh
        parts[name] = [f"mesh{k}_{i}_{stem}{ending}" for i, (_, ending) in enumerate(found)]
        assets |= zip(parts[name], (content for content, _ in found), strict=True)
    for link in root.iterfind("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        for collision in link.findall("collision"):
            _name_parts(link, collision, parts)
    for inertia in root.iterfind("link/inertial/inertia"):
        _make_possible(inertia)
    _put_on_a_base(root)
    try:
        spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"), assets=assets)
    except (ValueError, RuntimeError) as error:
        raise SceneError(" ".join(str(error).split()), file=None if folder is None else str(source)) from None
    return UrdfRobot(name=root.get("name") or "robot", joints=tuple(map(_joint, root.iterfind("joint"))), spec=spec)


def _meshes_of(root: ET.Element, links: Collection[str]) -> set[str]:
    """Return the names of the collision meshes of links; raises UnknownNameError if there is no such link."""
    known = {link.get("name", ""): link for link in root.iterfind("link")}
    for name in links:
        if name not in known:
            raise UnknownNameError("link", name, known)
    return {mesh.get("filename", "") for name in links for mesh in known[name].iterfind("collision/geometry/mesh")}


def _in_parts(
    content: bytes, ending: str, name: str, decompose: bool | None, *, closely: bool
) -> list[tuple[bytes, str]]:
    """Return contents and suffixes of the mesh files that replace a mesh: its convex parts, or the mesh itself."""
    if decompose is False:
        return [(content, ending)]
    triangles = mesh_triangles(content, ending, name)
    parts = convex_parts(triangles, Path(name).name, needed=bool(decompose), closely=closely)
    return [(obj_content(part_triangles(part)), ".obj") for part in parts] or [(content, ending)]


def _name_parts(link: ET.Element, collision: ET.Element, parts: Mapping[str, Sequence[str]]) -> None:
    """Replace a mesh by its parts, each in a separate collision element."""
    mesh = collision.find("geometry/mesh")
    if mesh is None:
        return
    first, *others = parts[mesh.get("filename", "")]
    mesh.set("filename", first)
    for k, other in enumerate(others):
        twin = copy.deepcopy(collision)
        if "name" in twin.attrib:
            twin.set("name", f"{twin.get('name')}_part{k + 1}")
        twin_mesh = twin.find("geometry/mesh")
        assert twin_mesh is not None
        twin_mesh.set("filename", other)
        link.append(twin)


def _make_possible(inertia: ET.Element) -> None:
    """Raise principal moments below the least possible ones, such as zeros."""
    xx, yy, zz, xy, xz, yz = (_number(inertia, name, 0.0, "inertia") for name in _MOMENTS)
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if not np.isfinite(matrix).all():
        raise SceneError("an inertia is not finite")
    moments, axes = np.linalg.eigh(matrix)
    if moments.min() < _LEAST_INERTIA:
        matrix = axes @ np.diag(np.maximum(moments, _LEAST_INERTIA)) @ axes.T
        for name, value in zip(_MOMENTS, (*np.diag(matrix), matrix[0, 1], matrix[0, 2], matrix[1, 2]), strict=True):
            inertia.set(name, repr(float(value)))


def _put_on_a_base(root: ET.Element) -> None:
    """Add a parent link to the root link, because MuJoCo merges a root link into the world body."""
    children = {child.get("link") for child in root.iterfind("joint/child")}
    roots = [str(link.get("name")) for link in root.iterfind("link") if link.get("name") not in children]
    if len(roots) != 1:
        raise SceneError(f"a robot has one root link, not {roots or 'none'}")
    for extension in root.findall("mujoco"):
        root.remove(extension)
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", _SETTINGS)
    ET.SubElement(root, "link", name=BASE)
    joint = ET.SubElement(root, "joint", name=f"{BASE}_joint", type="fixed")
    ET.SubElement(joint, "parent", link=BASE)
    ET.SubElement(joint, "child", link=roots[0])


BASE = "graceful_plan_base"
"""Name of the added parent of the root link."""


def _joint(element: ET.Element) -> UrdfJoint:
    name, kind = element.get("name", ""), element.get("type", "")
    parent, child, limit, mimic = (element.find(tag) for tag in ("parent", "child", "limit", "mimic"))
    if parent is None or child is None:
        raise SceneError(f"the joint {name!r} has no parent or no child")
    velocity = _number(limit, "velocity", np.inf, name)
    follows = None
    if mimic is not None:
        follows = mimic.get("joint", ""), _number(mimic, "multiplier", 1.0, name), _number(mimic, "offset", 0.0, name)
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=parent.get("link", ""),
        child=child.get("link", ""),
        velocity=velocity if velocity > 0.0 else np.inf,
        position=_position_limits(limit, kind, name),
        mimic=follows,
    )


def _position_limits(limit: ET.Element | None, kind: str, joint: str) -> tuple[float, float] | None:
    """Return the position limits of a joint; None if it has none.

    Joints other than continuous ones need limits by the format, but many readers accept files without.
    """
    if kind not in ("revolute", "prismatic"):
        return None
    if limit is None:
        _LOG.warning("the %s joint %r has no <limit>; it is planned as if it had none", kind, joint)
        return None
    lower, upper = _number(limit, "lower", 0.0, joint), _number(limit, "upper", 0.0, joint)
    if lower > upper:
        raise SceneError(f"joint {joint!r}: the lower limit {lower:g} is above the upper limit {upper:g}")
    return lower, upper


def _number(element: ET.Element | None, attribute: str, default: float, joint: str) -> float:
    given = None if element is None else element.get(attribute)
    if given is None:
        return default
    try:
        return float(given)
    except ValueError:
        raise SceneError(f"joint {joint!r}: {attribute} is {given!r}, not a number") from None
