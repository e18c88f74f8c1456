"""Covers contain their geoms, are computed once, and are read from disk only if the file is intact."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from graceful_plan import disk_cache
from graceful_plan.core import covers, greedy_cover, sphere_cover
from graceful_plan.core.covers import group_cover, hull_triangles

_MESHES = """
<mujoco>
  <asset>{assets}</asset>
  <worldbody>{geoms}</worldbody>
</mujoco>
"""


def _model(seed: int, count: int = 3) -> mujoco.MjModel:
    rng = np.random.default_rng(seed)
    assets, geoms = "", ""
    for k in range(count):
        points = rng.normal(size=(40, 3))
        points *= rng.uniform(0.02, 0.09, 3) / np.abs(points).max(axis=0)
        assets += f'<mesh name="m{k}" vertex="{" ".join(f"{x:.5f}" for x in points.ravel())}"/>'
        geoms += f'<geom type="mesh" mesh="m{k}" pos="{0.05 * k} 0 0"/>'
    return mujoco.MjModel.from_xml_string(_MESHES.format(assets=assets, geoms=geoms))


def _poses(model: mujoco.MjModel) -> np.ndarray:
    X = np.tile(np.eye(4), (model.ngeom, 1, 1))
    X[:, :3, 3] = model.geom_pos
    for k, quaternion in enumerate(model.geom_quat):
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, quaternion)
        X[k, :3, :3] = R.reshape(3, 3)
    return X


@pytest.fixture(autouse=True)
def _empty(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("GRACEFUL_PLAN_NO_CACHE", raising=False)
    monkeypatch.setattr(covers, "_SLOW", 0.0)
    covers.forget()


def _inside(model: mujoco.MjModel, X: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Points inside hulls, many of them on corners, edges and faces."""
    points = []
    for geom in range(model.ngeom):
        corners = hull_triangles(model, int(model.geom_dataid[geom])).reshape(-1, 3)
        weights = rng.dirichlet(np.full(3, 0.5), 4000)
        some = np.einsum("nk,nkx->nx", weights, corners[rng.integers(len(corners), size=(4000, 3))])
        points.append(np.concatenate([some, corners]) @ X[geom, :3, :3].T + X[geom, :3, 3])
    return np.concatenate(points)


@pytest.mark.parametrize("seed", [0, 1])
def test_links_of_meshes_are_contained(seed: int) -> None:
    model = _model(seed)
    X, geoms = _poses(model), tuple(range(model.ngeom))
    cover = group_cover(model, geoms, X, base=False)
    points = _inside(model, X, np.random.default_rng(seed))
    apart = np.linalg.norm(points[:, None] - cover.spheres[:, :3], axis=-1) - cover.spheres[:, 3]
    assert apart.min(axis=1).max() <= 1e-9
    assert cover.protrusion == sphere_cover.MAX_PROTRUSION
    away = np.linalg.norm(cover.spheres[:, :3] - cover.bound[:3], axis=1) + cover.spheres[:, 3]
    assert away.max() <= cover.bound[3] + 1e-9


def test_a_large_base_is_covered_once_by_large_spheres(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    points = rng.uniform(-1.0, 1.0, (60, 3)) * [0.35, 0.3, 0.2]
    mesh = f'<mesh name="m" vertex="{" ".join(f"{x:.5f}" for x in points.ravel())}"/>'
    geom = '<geom type="mesh" mesh="m"/>'
    model = mujoco.MjModel.from_xml_string(_MESHES.format(assets=mesh, geoms=geom))
    asked, cover_of = [], greedy_cover.hull_cover
    monkeypatch.setattr(greedy_cover, "hull_cover", lambda *given: asked.append(given[1]) or cover_of(*given))
    X = _poses(model)
    cover = group_cover(model, (0,), X, base=True)
    assert asked == [covers.BASE_PROTRUSION]
    inside = _inside(model, X, rng)
    apart = np.linalg.norm(inside[:, None] - cover.spheres[:, :3], axis=-1) - cover.spheres[:, 3]
    assert apart.min(axis=1).max() < 1e-9


def test_a_cover_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    model = _model(2)
    X, geoms = _poses(model), tuple(range(model.ngeom))
    first = group_cover(model, geoms, X, base=False)
    assert group_cover(model, geoms, X.copy(), base=False) is first
    moved = X.copy()
    moved[0, 0, 3] += 0.01
    assert group_cover(model, geoms, moved, base=False) is not first
    covers.forget()

    def refuse(*_: object) -> None:
        raise AssertionError("made again")

    monkeypatch.setattr(greedy_cover, "hull_cover", refuse)
    again = group_cover(model, geoms, X, base=False)  # from the cache folder
    np.testing.assert_array_equal(again.spheres, first.spheres)


@pytest.mark.parametrize("damage", ["cut", "flipped", "text", "smaller", "shape", "nan"])
def test_a_broken_file_is_made_again(damage: str) -> None:
    model = _model(3, count=1)
    X = _poses(model)
    first = group_cover(model, (0,), X, base=False)
    folder = disk_cache.folder()
    assert folder is not None
    (file,) = folder.glob("*.npz")
    content = bytearray(file.read_bytes())
    whole = disk_cache.read(file.stem)
    assert whole is not None
    if damage == "cut":
        file.write_bytes(content[: len(content) // 2])
    elif damage == "flipped":
        content[len(content) // 2] ^= 0xFF
        file.write_bytes(content)
    elif damage == "text":
        file.write_text("nothing")
    elif damage == "smaller":
        disk_cache.write(file.stem, whole - [0.0, 0.0, 0.0, 0.02])
    elif damage == "shape":
        disk_cache.write(file.stem, whole[:, :3])
    else:
        disk_cache.write(file.stem, np.where(np.arange(4) == 3, np.nan, whole))
    covers.forget()
    again = group_cover(model, (0,), X, base=False)
    np.testing.assert_array_equal(again.spheres, first.spheres)
    repaired = disk_cache.read(file.stem)
    assert repaired is not None and repaired.shape == whole.shape


def test_a_disabled_or_unwritable_cache_is_ignored(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GRACEFUL_PLAN_NO_CACHE", "1")
    model = _model(4, count=1)
    group_cover(model, (0,), _poses(model), base=False)
    assert disk_cache.folder() is None and not list(tmp_path.iterdir())
    monkeypatch.delenv("GRACEFUL_PLAN_NO_CACHE")
    in_the_way = tmp_path / "file"
    in_the_way.write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(in_the_way))
    covers.forget()
    assert len(group_cover(model, (0,), _poses(model), base=False).spheres)
