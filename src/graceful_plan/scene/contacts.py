"""Contact filters: pairs of geoms that MuJoCo tests, by its own rules, and the contacts that a scene allows.

The rules are those of MuJoCo's manual, section "Collision detection": contype and conaffinity, bodies welded
together, parent and child (unless the parent is welded to the world), excluded body pairs, listed geom pairs.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Bool, Int
from graceful_plan.scene.elements import AllowedContact, Notes
from graceful_plan.scene.loading.naming import is_name, lookup
from graceful_plan.scene.model_parts import colliding_geoms, find, names, rigid_group

_OBJ = mujoco.mjtObj


def tested_pairs(model: mujoco.MjModel, moving: Collection[int]) -> Int[Array, "pair 2"]:
    """Return every geom pair that MuJoCo tests and that has at least one geom on a body in `moving`.

    The first geom of a pair belongs to such a body. If both do, a geom that is not welded to the world comes first,
    then the one with the lower id.
    """
    body = np.asarray(model.geom_bodyid)
    weld = np.asarray(model.body_weldid)[body]
    mine = np.isin(body, list(moving))
    # Only the rows of these geoms: there may be thousands of others.
    rows = np.flatnonzero(mine)
    tested = _affine(model, rows) & ~_related(model, weld, rows) & ~_excluded(model, body, rows)
    tested &= weld[rows, None] != weld[None, :]
    row = np.full(model.ngeom, -1)
    row[rows] = np.arange(len(rows))
    for first, second in ((model.pair_geom1, model.pair_geom2), (model.pair_geom2, model.pair_geom1)):
        listed = row[first] >= 0
        tested[row[first[listed]], second[listed]] = True
    # Keep either (a, b) or (b, a), with a moving geom first.
    rank = np.arange(model.ngeom) + model.ngeom * (weld == 0)
    tested &= ~mine[None, :] | (rank[rows, None] < rank[None, :])
    first, second = np.nonzero(tested)
    return np.stack([rows[first], second], axis=1)


def _affine(model: mujoco.MjModel, rows: Int[Array, " row"]) -> Bool[Array, "row geom"]:
    contype, conaffinity = np.asarray(model.geom_contype), np.asarray(model.geom_conaffinity)
    there = (contype[rows, None] & conaffinity[None, :]) != 0
    return there | ((conaffinity[rows, None] & contype[None, :]) != 0)


def _related(model: mujoco.MjModel, weld: Int[Array, " geom"], rows: Int[Array, " row"]) -> Bool[Array, "row geom"]:
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT):
        return np.zeros((len(rows), len(weld)), dtype=bool)
    parent = np.asarray(model.body_weldid)[np.asarray(model.body_parentid)[weld]]
    child_of = (weld[rows, None] == parent[None, :]) | (parent[rows, None] == weld[None, :])
    return child_of & (weld[rows, None] != 0) & (weld[None, :] != 0)


def _excluded(model: mujoco.MjModel, body: Int[Array, " geom"], rows: Int[Array, " row"]) -> Bool[Array, "row geom"]:
    excluded = np.zeros((len(rows), len(body)), dtype=bool)
    for signature in np.asarray(model.exclude_signature):
        bodies = int(signature) >> 16, int(signature) & 0xFFFF
        for first, second in (bodies, bodies[::-1]):
            excluded |= (body[rows, None] == first) & (body[None, :] == second)
    return excluded


def declared_contacts(model: mujoco.MjModel, notes: Notes, gripper: Collection[int]) -> tuple[AllowedContact, ...]:
    """Return all allowed contacts: those declared, gripper with held object, and held object with supports at the ends.

    Args:
        model: The model.
        notes: The declarations.
        gripper: Bodies that may touch the held object.

    Raises:
        UnknownNameError: If a name is neither a body nor a geom.
    """
    found = list(notes.allowed)
    if notes.held is not None:
        solid = [b for b in sorted(gripper) if colliding_geoms(model, [b])]
        found += [AllowedContact(name, notes.held.body, "always") for name in names(model, _OBJ.mjOBJ_BODY, solid)]
        found += [AllowedContact(notes.held.body, support, "ends") for support in notes.support]
    with notes.about("allowed_contacts"):
        for contact in found:
            geoms_named(model, contact.first)
            geoms_named(model, contact.second)
    return tuple(found)


def geoms_named(model: mujoco.MjModel, name: str) -> tuple[int, ...]:
    """Return the geoms of the rigid group of bodies whose first body has this name, or else the geom of this name.

    A geom takes precedence over a body of the same name that has no colliding geoms. A geom that is divided into convex
    parts stands for the parts.

    Raises:
        UnknownNameError: If there is neither a body nor a geom of this name.
    """
    body = lookup(model, _OBJ.mjOBJ_BODY, name)
    if body < 0 and is_name(name):
        # `names` calls unnamed bodies "#<id>".
        body = next((b for b in range(model.nbody) if name == f"#{b}"), -1)
    found = colliding_geoms(model, {0} if body == 0 else rigid_group(model, body)) if body >= 0 else ()
    if found or (body >= 0 and lookup(model, _OBJ.mjOBJ_GEOM, name) < 0):
        return found
    geom = find(model, _OBJ.mjOBJ_GEOM, "body or geom", name)
    parts = [g for g in range(model.ngeom) if model.geom(g).name.startswith(f"{name}#")]
    return tuple(parts) or (geom,)


def allowed_pairs(model: mujoco.MjModel, contacts: Iterable[AllowedContact], when: str) -> frozenset[tuple[int, int]]:
    """Return the geom pairs, lower id first, that may touch "always" or at the "ends"."""
    return frozenset(
        (min(a, b), max(a, b))
        for contact in contacts
        if contact.when == when
        for a in geoms_named(model, contact.first)
        for b in geoms_named(model, contact.second)
    )


def without(pairs: Int[Array, "pair 2"], allowed: Collection[tuple[int, int]]) -> Int[Array, "kept 2"]:
    """Return the pairs that are not in `allowed`, as a read-only array."""
    kept = pairs
    if allowed:
        keep = [pair not in allowed for pair in map(tuple, np.sort(pairs, axis=1).tolist())]
        kept = pairs[np.array(keep, dtype=bool)]
    kept.flags.writeable = False
    return kept


def unchecked_links(
    model: mujoco.MjModel,
    robot: Collection[int],
    checked: Int[Array, "pair 2"],
    contacts: Iterable[AllowedContact],
) -> tuple[int, Mapping[str, Sequence[tuple[str, str]]]]:
    """Return the number of link pairs that are checked, and all other pairs by the reason why they are not.

    A link is a group of the robot's bodies without joints in between, named after its first body; links without
    colliding geoms are skipped. The reason is that of the `AllowedContact` ("allowed" if it has none), "adjacent" for
    parent and child, or "filters of the model" for masks and excluded pairs.

    Args:
        model: The model.
        robot: Bodies of the robot.
        checked: Pairs of geoms that may not touch.
        contacts: Allowed contacts.
    """
    weld = np.asarray(model.body_weldid)
    of_geom = weld[np.asarray(model.geom_bodyid)]
    mine = colliding_geoms(model, robot)
    links = sorted({int(of_geom[geom]) for geom in mine})
    first_body = {link: min(body for body in robot if weld[body] == link) for link in links}
    kept = {(int(a), int(b)) for a, b in np.sort(of_geom[checked[np.isin(checked, mine).all(axis=1)]], axis=1)}
    reasons: dict[tuple[int, int], str] = {}
    for contact in contacts:
        if contact.when == "always":
            ends = [
                {int(of_geom[geom]) for geom in geoms_named(model, name)} for name in (contact.first, contact.second)
            ]
            reasons |= {(min(a, b), max(a, b)): contact.reason or "allowed" for a in ends[0] for b in ends[1]}
    unchecked: dict[str, list[tuple[str, str]]] = {}
    for k, first in enumerate(links):
        for second in links[k + 1 :]:
            if (first, second) in kept:
                continue
            adjacent = first == weld[model.body_parentid[second]]
            reason = reasons.get((first, second), "adjacent" if adjacent else "filters of the model")
            pair = tuple(names(model, _OBJ.mjOBJ_BODY, (first_body[first], first_body[second])))
            unchecked.setdefault(reason, []).append((pair[0], pair[1]))
    return len(kept), unchecked
