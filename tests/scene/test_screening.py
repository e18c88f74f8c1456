from __future__ import annotations

import re
import zlib
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from places import LIBRARY

import graceful_plan as gp
from graceful_plan.exceptions import GracefulPlanError, SceneError, SettingError, TooLargeError
from graceful_plan.scene.loading.weighing import mesh_weight
from graceful_plan.scene.model_checks import check_numbers, check_supported
from graceful_plan.scene.specs import compile_spec, load_spec, within_memory
from graceful_plan.scene.urdf.reading import read_urdf

_SCENES = LIBRARY / "scene" / "scenes"
_BOX = '<geom type="box" size="1 1 1"/>'


def _write(folder: Path, name: str, body: str) -> Path:
    file = folder / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(body)
    return file


def _refusal(file: Path) -> SceneError:
    with pytest.raises(SceneError) as caught:
        load_spec(file)
    return caught.value


def test_a_harmless_world_passes_with_its_includes(tmp_path: Path) -> None:
    _write(tmp_path, "parts/cup.xml", f'<mujocoinclude><body name="cup">{_BOX}</body></mujocoinclude>')
    world = _write(tmp_path, "world.xml", '<mujoco><worldbody><include file="parts/cup.xml"/></worldbody></mujoco>')
    model = compile_spec(load_spec(world))
    assert model.body("cup").id == 1


def test_text_and_specs_pass_too() -> None:
    text = f"<mujoco><worldbody><body name='cup'>{_BOX}</body></worldbody></mujoco>"
    assert compile_spec(load_spec(text)).nbody == 2
    spec = mujoco.MjSpec.from_string(text)
    copy = load_spec(spec)
    copy.worldbody.add_body(name="plate").add_geom(size=[1, 0, 0])
    assert compile_spec(copy).nbody == 3
    assert compile_spec(spec).nbody == 2


def test_small_replicas_are_welcome() -> None:
    text = f"<mujoco><worldbody><replicate count='12' offset='3 0 0'>{_BOX}</replicate></worldbody></mujoco>"
    assert compile_spec(load_spec(text)).ngeom == 12


def test_a_folder_may_be_given_that_files_are_in(tmp_path: Path) -> None:
    _write(tmp_path, "shared/cup.xml", f'<mujocoinclude><body name="cup">{_BOX}</body></mujocoinclude>')
    _write(tmp_path, "meshes/a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    body = '<geom type="mesh" mesh="a"/><include file="../shared/cup.xml"/>'
    text = f"""<mujoco><compiler meshdir="../meshes"/><asset><mesh name="a" file="a.obj"/></asset>
      <worldbody>{body}</worldbody></mujoco>"""
    world = _write(tmp_path, "robot/world.xml", text)
    told = _refusal(world).message
    assert "meshdir='../meshes'" in told and "folder=DIR" in told
    model = compile_spec(load_spec(world, tmp_path))
    assert model.body("cup").id == 1 and model.nmesh == 1
    with pytest.raises(SettingError, match=r"'.*meshes'.*world\.xml"):
        load_spec(world, tmp_path / "meshes")
    with pytest.raises(SettingError, match="folder = "):
        load_spec(world, world)


@pytest.mark.parametrize("given", ["../../x.xml", "/etc/passwd", "../link/x.xml", "../link/../../x.xml"])
def test_nothing_outside_of_a_folder_that_was_given(tmp_path: Path, given: str) -> None:
    root = tmp_path / "root"
    _write(tmp_path, "x.xml", "<mujocoinclude/>")
    _write(root, "y.xml", "<mujocoinclude/>")
    (root / "link").symlink_to(tmp_path, target_is_directory=True)
    world = _write(root, "robot/world.xml", f'<mujoco><worldbody><include file="{given}"/></worldbody></mujoco>')
    with pytest.raises(SceneError, match=f"'{root}'"):
        load_spec(world, root)


_HOSTILE = {  # attack: (line, words of the message, content of line 2)
    "doctype": (2, "document type", '<!DOCTYPE mujoco [<!ENTITY a "aaaa">]>'),
    "instruction": (2, "processing instructions", "<?php echo 1 ?>"),
    "billion replicas": (
        2,
        "count='1000000000' is more than 4096",
        f'<replicate count="1000000000">{_BOX}</replicate>',
    ),
    "nested replicas": (
        2,
        "more than 50000 elements",
        '<replicate count="4000"><replicate count="4000"><replicate count="4000"/></replicate></replicate>',
    ),
    "infinite replicas": (2, "count='inf' is more", '<replicate count="inf"/>'),
    "no number of replicas": (2, "count='nan' is more", '<replicate count="nan"/>'),
    "nan position": (2, "pos='0 NaN 0' of <body> is not finite", '<body pos="0 NaN 0"/>'),
    "infinite size": (2, "size='1 -inf 1' of <geom> is not finite", '<geom type="box" size="1 -inf 1"/>'),
    "odd nan": (2, r"pos='nan\(7\) 0 0'", '<body pos="nan(7) 0 0"/>'),
    "absolute include": (2, "include of '/etc/passwd': only files in the folder", '<include file="/etc/passwd"/>'),
    "include above": (2, r"include of '\.\./x\.xml': only files", '<include file="../x.xml"/>'),
    "include in and out": (2, "only files", '<include file="a/../../x.xml"/>'),
    "include with backslashes": (2, "only files", '<include file="..\\x.xml"/>'),
    "missing include": (2, "there is no such file", '<include file="x.xml"/>'),
    "empty include": (2, "there is no such file", '<include file=""/>'),
    "composite": (2, "composite bodies are not supported", '<composite count="9 9 9"/>'),
    "flex": (2, "flexible bodies", '<flexcomp count="99 99 99"/>'),
    "plugin": (2, "plugins are not supported", '<plugin plugin="mujoco.elasticity.cable"/>'),
    "broken": (2, "broken XML: .*token", "<body>< /body>"),
}


@pytest.mark.parametrize("attack", _HOSTILE)
def test_hostile_worlds_are_refused_with_file_and_line(attack: str, tmp_path: Path) -> None:
    line, words, content = _HOSTILE[attack]
    if attack in ("doctype", "instruction"):
        text = f"<!-- world -->\n{content}\n<mujoco/>"
    else:
        text = f"<mujoco><worldbody>\n{content}\n</worldbody></mujoco>"
    file = _write(tmp_path, "world.xml", text)
    error = _refusal(file)
    assert re.search(words, error.message)
    assert (error.file, error.line) == (str(file), line)
    assert str(error).startswith(f"{file}:{line}: ")


_SECTIONS = {
    "negative timestep": ("the timestep is -0.002", '<option timestep="-0.002"/>'),
    "zero timestep": ("the timestep is 0", '<option timestep="0"/>'),
    "nan timestep": ("the timestep is nan", '<option timestep="nan"/>'),
    "memory": ("memory size", '<size memory="900G"/>'),
    "user data": ("nuser_body='1000000000' is more than", '<size nuser_body="1000000000"/>'),
    "numbers": ("size='1000000000' is more than", '<custom><numeric name="a" size="1000000000"/></custom>'),
    "nan in numbers": (
        "data='1 nan' of <numeric> is not finite",
        '<custom><numeric name="a" data="1 nan"/></custom>',
    ),
    "texture": ("width='100000' is more than", '<asset><texture name="a" builtin="flat" width="100000"/></asset>'),
    "height field": ("nrow='99999' is more than", '<asset><hfield name="a" nrow="99999" ncol="9"/></asset>'),
    "mesh outside": ("file '../a.stl' of <mesh>: only files", '<asset><mesh file="../a.stl"/></asset>'),
    "mesh anywhere": ("file '/dev/zero' of <mesh>: only files", '<asset><mesh file="/dev/zero"/></asset>'),
    "texture anywhere": ("of <texture>: only files", '<asset><texture type="2d" file="/dev/zero"/></asset>'),
    "cube texture": (
        "'/dev/zero' of <texture>: only files",
        '<asset><texture name="a" fileright="/dev/zero"/></asset>',
    ),
    "model anywhere": ("of <model>: only files", '<asset><model name="a" file="/etc/passwd"/></asset>'),
    "mesh folder": ("meshdir='/' is outside", '<compiler meshdir="/"/>'),
    "asset folder": ("assetdir='..' is outside", '<compiler assetdir=".."/>'),
    "built-in mesh": ("built-in meshes", '<asset><mesh name="a" builtin="sphere" params="30"/></asset>'),
}


@pytest.mark.parametrize("attack", _SECTIONS)
def test_hostile_sections_are_refused_with_file_and_line(attack: str, tmp_path: Path) -> None:
    words, content = _SECTIONS[attack]
    file = _write(tmp_path, "world.xml", f"<mujoco>\n{content}\n</mujoco>")
    error = _refusal(file)
    assert words in error.message
    assert (error.file, error.line) == (str(file), 2)


def test_another_kind_of_xml_is_refused(tmp_path: Path) -> None:
    error = _refusal(_write(tmp_path, "robot.xml", '<robot name="urdf"/>'))
    assert "<robot>" in error.message and "<mujoco>" in error.message


def test_deep_nesting_is_refused(tmp_path: Path) -> None:
    deep = "<mujoco><worldbody>" + "<body>" * 5000 + "</body>" * 5000 + "</worldbody></mujoco>"
    assert "200" in _refusal(_write(tmp_path, "world.xml", deep)).message


def test_a_huge_file_is_refused_unread(tmp_path: Path) -> None:
    file = tmp_path / "world.xml"
    with file.open("wb") as stream:
        stream.truncate(3_000_000_000)  # sparse: takes no space
    assert "10000000" in _refusal(file).message


def test_a_link_that_leads_outside_is_refused(tmp_path: Path) -> None:
    _write(tmp_path, "secret.xml", "<mujocoinclude/>")
    world = _write(tmp_path, "scene/world.xml", '<mujoco><include file="link.xml"/></mujoco>')
    (tmp_path / "scene" / "link.xml").symlink_to(tmp_path / "secret.xml")
    assert "'link.xml'" in _refusal(world).message


def test_a_circle_of_includes_is_refused(tmp_path: Path) -> None:
    world = _write(tmp_path, "a.xml", '<mujoco><include file="b.xml"/></mujoco>')
    _write(tmp_path, "b.xml", '<mujoco><include file="a.xml"/></mujoco>')
    error = _refusal(world)
    assert "includes itself" in error.message


def test_replicas_multiply_through_includes(tmp_path: Path) -> None:
    _write(tmp_path, "many.xml", f'<mujocoinclude><replicate count="4000">{_BOX}</replicate></mujocoinclude>')
    body = '<replicate count="100">\n<include file="many.xml"/></replicate>'
    world = _write(tmp_path, "world.xml", f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    error = _refusal(world)
    assert "more than 50000 elements" in error.message
    assert error.file is not None and error.file.endswith("many.xml")


def test_an_included_file_is_screened_under_its_own_name(tmp_path: Path) -> None:
    _write(tmp_path, "part.xml", '<mujocoinclude>\n\n<body pos="nan 0 0"/></mujocoinclude>')
    world = _write(tmp_path, "world.xml", '<mujoco><worldbody><include file="part.xml"/></worldbody></mujoco>')
    error = _refusal(world)
    assert error.file is not None and error.file.endswith("part.xml")
    assert error.line == 3


def test_text_cannot_include_anything() -> None:
    with pytest.raises(SceneError, match="folder"):
        load_spec('<mujoco><include file="world.xml"/></mujoco>')


def test_text_has_no_files_beside_it() -> None:
    with pytest.raises(SceneError, match=r"<text>:1: .*'a\.stl'.*<mesh>"):
        load_spec('<mujoco><asset><mesh file="a.stl"/></asset></mujoco>')


def test_a_linked_asset_in_a_declared_folder_is_refused(tmp_path: Path) -> None:
    _write(tmp_path, "secret.stl", "solid")
    world = _write(
        tmp_path, "scene/world.xml", '<mujoco><asset><mesh file="a.stl"/></asset><compiler meshdir="m"/></mujoco>'
    )
    (tmp_path / "scene" / "m").mkdir()
    (tmp_path / "scene" / "m" / "a.stl").symlink_to(tmp_path / "secret.stl")
    assert "'a.stl' of <mesh>" in _refusal(world).message


def test_an_include_beside_the_including_file_is_screened_as_well(tmp_path: Path) -> None:
    world = _write(tmp_path, "world.xml", '<mujoco><include file="parts/a.xml"/></mujoco>')
    _write(tmp_path, "parts/a.xml", '<mujocoinclude><include file="b.xml"/></mujocoinclude>')
    _write(tmp_path, "parts/b.xml", '<mujocoinclude><option timestep="-1"/></mujocoinclude>')
    _write(tmp_path, "b.xml", "<mujocoinclude/>")
    assert "timestep" in _refusal(world).message


def test_an_attached_model_is_screened_as_well(tmp_path: Path) -> None:
    world = _write(tmp_path, "world.xml", '<mujoco><asset><model name="arm" file="arm.xml"/></asset></mujoco>')
    _write(tmp_path, "arm.xml", '<mujoco><worldbody><body pos="nan 0 0"/></worldbody></mujoco>')
    assert "pos='nan 0 0' of <body>" in _refusal(world).message


@pytest.mark.parametrize("name", ["nan", "inf", "Infinity"])
def test_words_that_look_like_numbers_may_be_names(name: str) -> None:
    text = f'<mujoco><worldbody><body name="{name}">{_BOX}</body></worldbody></mujoco>'
    assert compile_spec(load_spec(text)).body(name).id == 1


def test_missing_files_and_folders(tmp_path: Path) -> None:
    assert "No such file" in _refusal(tmp_path / "none.xml").message
    assert "Is a directory" in _refusal(tmp_path).message
    assert "binary" in _refusal(tmp_path / "model.mjb").message


def test_mujocos_own_complaints_keep_their_line(tmp_path: Path) -> None:
    file = _write(tmp_path, "world.xml", "<mujoco>\n<worldbody>\n<bodi/>\n</worldbody></mujoco>")
    error = _refusal(file)
    assert "unrecognized element" in error.message
    assert (error.file, error.line) == (str(file), 3)


def test_uncompilable_models_raise_a_scene_error() -> None:
    spec = load_spec('<mujoco><worldbody><body><freejoint/><geom size="-1"/></body></worldbody></mujoco>')
    with pytest.raises(SceneError, match="size"):
        compile_spec(spec)


def _pile(bodies: int) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="ball").add_joint()
    spec.body("ball").add_geom(size=[0.1, 0.0, 0.0])
    for k in range(bodies):
        spec.worldbody.add_body(pos=[0.0, 0.0, 0.01 * k]).add_geom(size=[0.02, 0.0, 0.0])
    return spec


def _contacts(model: mujoco.MjModel) -> int:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    return data.ncon


def test_there_is_memory_for_thousands_of_bodies() -> None:
    assert _contacts(compile_spec(_pile(2000))) == 13


def test_models_beyond_the_memory_are_refused() -> None:
    model = _pile(2000).compile()  # with MuJoCo's default
    with pytest.raises(TooLargeError, match=r"a pile.*memory"):
        with within_memory("a pile"):
            _contacts(model)
    with pytest.raises(TooLargeError) as caught, within_memory("numpy"):
        raise MemoryError
    assert caught.value.what == "numpy"
    assert isinstance(caught.value, GracefulPlanError) and isinstance(caught.value, MemoryError)


def _png(width: int, height: int) -> bytes:
    return b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR" + width.to_bytes(4, "big") + height.to_bytes(4, "big") + b"\x08\x02"


_TOO_MUCH = {  # excess by kind: words of the message, content, count; many elements are allowed singly
    "height fields": (
        "cells of height fields",
        '<asset><hfield name="h{}" nrow="4096" ncol="4096" size="1 1 1 1"/></asset>',
        200,
    ),
    "cube textures": ("pixels of textures", '<asset><texture name="t{}" builtin="flat" width="4096"/></asset>', 40),
    "numerics": ("numbers in <numeric>", '<custom><numeric name="n{}" size="4096"/></custom>', 20_000),
    "users' own": (
        "user-defined numbers",
        '<worldbody><site name="s{}"/></worldbody><size nuser_site="100" nuser_geom="100"/>',
        300,
    ),
}


@pytest.mark.parametrize("attack", _TOO_MUCH)
def test_budgets_are_for_all_elements_together(tmp_path: Path, attack: str) -> None:
    words, one, many = _TOO_MUCH[attack]
    body = "".join(one.format(k) for k in range(many))
    assert words in str(_refusal(_write(tmp_path, "world.xml", f"<mujoco>{body}</mujoco>")))


def test_files_are_weighed_by_their_headers(tmp_path: Path) -> None:
    """An image of 20,000 x 20,000 pixels in 26 bytes, and a mesh of a million vertices, before they are decoded."""
    (tmp_path / "huge.png").write_bytes(_png(20_000, 20_000))
    textured = _write(
        tmp_path, "t.xml", '<mujoco><asset><texture name="t" type="2d" file="huge.png"/></asset></mujoco>'
    )
    assert "'huge.png'" in str(_refusal(textured))
    hills = _write(
        tmp_path, "h.xml", '<mujoco><asset><hfield name="h" file="huge.png" size="1 1 1 1"/></asset></mujoco>'
    )
    assert "cells of height fields" in str(_refusal(hills))
    (tmp_path / "fine.obj").write_bytes(b"v 0 0 0" + b"\nv 0 0 0" * 1_000_000 + b"\nf 1 2 3")
    mesh = _write(tmp_path, "m.xml", '<mujoco><asset><mesh name="m" file="fine.obj"/></asset></mujoco>')
    assert "'fine.obj' has 1000001 " in str(_refusal(mesh))
    collision = '<collision><geometry><mesh filename="fine.obj"/></geometry></collision>'
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm"><link name="hand">{collision}</link></robot>')
    with pytest.raises(SceneError, match=r"fine\.obj: 1000001.*1000000"):
        read_urdf(tmp_path / "arm.urdf")


def test_meshes_are_weighed_together(tmp_path: Path) -> None:
    names = [f"part{k}.obj" for k in range(3)]
    for name in names:
        (tmp_path / name).write_bytes(b"v 0 0 0\n" * 700_000)
    meshes = "".join(f'<mesh name="m{k}" file="{name}"/>' for k, name in enumerate(names))
    model = _write(tmp_path, "m.xml", f"<mujoco><asset>{meshes}</asset></mujoco>")
    assert "2000000" in str(_refusal(model))


def test_corners_of_an_stl_that_are_at_one_place_count_once() -> None:
    """A closed surface has half as many corners as faces; loose triangles have three times as many."""
    corners = np.random.default_rng(0).normal(size=(302, 3)).astype("<f4")
    triangles = np.zeros(600, dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    triangles["corners"] = corners[np.arange(1800).reshape(600, 3) % 302]
    head = bytes(80) + len(triangles).to_bytes(4, "little")
    assert mesh_weight(head + triangles.tobytes(), ".STL") == 600 + 302
    triangles["corners"] = np.arange(5400).reshape(600, 3, 3)
    assert mesh_weight(head + triangles.tobytes(), ".stl") == 600 + 1800
    assert mesh_weight(b"", ".stl") == mesh_weight(b"solid", ".stl") == 0


def test_numbers_of_users_own_count_for_each_element() -> None:
    body = f'<replicate count="4000">{_BOX}</replicate>'
    text = '<mujoco><size nuser_geom="{}"/><worldbody>' + body + "</worldbody></mujoco>"
    assert compile_spec(load_spec(text.format(100))).nuser_geom == 100
    with pytest.raises(SceneError, match=r"4096.*10000000"):
        load_spec(text.format(4096))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")


def _picture(pixels: bytes, before: bytes = b"") -> bytes:
    """Return a PNG of 4 x 4 pixels with these data."""
    header = _chunk(b"IHDR", b"\0\0\0\4\0\0\0\4\x08\2\0\0\0")
    return b"\x89PNG\r\n\x1a\n" + header + before + _chunk(b"IDAT", zlib.compress(pixels)) + _chunk(b"IEND", b"")


def test_an_image_larger_than_its_header_is_refused(tmp_path: Path) -> None:
    """3 MB of zeros would become 3 GB; MuJoCo would notice afterwards."""
    world = _write(tmp_path, "w.xml", '<mujoco><asset><texture name="t" type="2d" file="a.png"/></asset></mujoco>')
    (tmp_path / "a.png").write_bytes(_picture(bytes(4 * 13)))
    assert compile_spec(load_spec(world)).ntex == 1
    (tmp_path / "a.png").write_bytes(_picture(bytes(4_000_000)))
    assert "4 x 4" in str(_refusal(world))
    (tmp_path / "a.png").write_bytes(_picture(bytes(4 * 13), 9 * _chunk(b"zTXt", b"a\0\0" + zlib.compress(bytes(9)))))
    assert "a.png holds 9 " in str(_refusal(world))
    # With another name: MuJoCo caches files that were written at the same moment.
    short = _write(tmp_path, "v.xml", world.read_text().replace("a.png", "b.png"))
    (tmp_path / "b.png").write_bytes(_picture(b"")[:-20])
    with pytest.raises(SceneError, match="PNG"):
        compile_spec(load_spec(short))


@pytest.mark.parametrize("line", [b"\n  v 0 0 0", b"\n\tv\t0 0 0", b"\rv 0 0 0", b"\n f 1 2 3"])
def test_lines_of_a_mesh_count_however_they_begin(tmp_path: Path, line: bytes) -> None:
    (tmp_path / "fine.obj").write_bytes(1_000_001 * line)
    mesh = _write(tmp_path, "m.xml", '<mujoco><asset><mesh name="m" file="fine.obj"/></asset></mujoco>')
    assert "vertices and faces" in str(_refusal(mesh))


@pytest.mark.parametrize(
    "tag", ['<include file="file:///etc/passwd"/>', '<asset><mesh name="m" file="http://a/b"/></asset>']
)
def test_addresses_are_refused(tmp_path: Path, tag: str) -> None:
    assert "no addresses" in str(_refusal(_write(tmp_path, "world.xml", f"<mujoco>{tag}</mujoco>")))


def test_bodies_kilometres_away_are_refused() -> None:
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody><body name='cup'>{_BOX}</body></worldbody></mujoco>")
    model.geom_size[0, 0] = 1e5
    with pytest.raises(SceneError, match=r"geom_size.*'#0'.*100000 m"):
        check_numbers(model)


def test_numbers_that_only_the_compiled_model_shows() -> None:
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody><body name='cup'>{_BOX}</body></worldbody></mujoco>")
    check_numbers(model)
    model.body_pos[1, 2] = float("nan")
    with pytest.raises(SceneError, match=r"body_pos.*'cup'.*finite"):
        check_numbers(model)
    model.body_pos[1, 2] = 0.0
    model.opt.timestep = -1.0
    with pytest.raises(SceneError, match=r"timestep.*-1\.0"):
        check_numbers(model)


_FIELD = '<asset><hfield name="hills" nrow="3" ncol="3" size="1 1 1 1"/></asset>'
_CONTACT_OFF = '<option><flag contact="disable"/></option>'


def test_unsupported_geoms_are_named() -> None:
    hills = '<worldbody><geom name="hills" type="hfield" hfield="hills"/></worldbody>'
    with pytest.raises(SceneError, match=r"'hills'.*hfield.*plane, sphere, .*mesh"):
        check_supported(compile_spec(load_spec(f"<mujoco>{_FIELD}{hills}</mujoco>")))
    painted = hills.replace("type=", 'contype="0" conaffinity="0" type=')
    check_supported(compile_spec(load_spec(f"<mujoco>{_FIELD}{painted}</mujoco>")))
    with pytest.raises(SceneError, match="contacts switched off"):
        check_supported(compile_spec(load_spec(f"<mujoco>{_CONTACT_OFF}</mujoco>")))


_TEXT = (_SCENES / "tabletop.xml").read_text()
_SNIPPETS = ["nan", "-1", "1e999", "../", "<replicate count='9999999'>", "&", "<", "\x00", '"', "inf", "0", ""]


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.tuples(st.integers(0, len(_TEXT)), st.integers(0, 12), st.sampled_from(_SNIPPETS)), min_size=1, max_size=3
    )
)
def test_damaged_worlds_load_or_are_refused(tmp_path: Path, cuts: list[tuple[int, int, str]]) -> None:
    text = _TEXT
    for start, length, snippet in cuts:
        text = text[:start] + snippet + text[start + length :]
    try:
        model = compile_spec(load_spec(_write(tmp_path, "world.xml", text)))
        check_numbers(model)
    except GracefulPlanError as error:
        assert isinstance(error, SceneError)


def test_sizes_for_contacts_are_left_to_mujoco():
    spec = load_spec('<mujoco><size nconmax="5000" njmax="5000"/><worldbody/></mujoco>')
    assert compile_spec(spec).narena < 100_000_000
    with pytest.raises(SceneError, match="nconmax"):
        load_spec('<mujoco><size nconmax="2000000"/><worldbody/></mujoco>')


def test_absolute_paths_below_a_given_folder_are_read(tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "scenes").mkdir()
    mesh, file = tmp_path / "meshes" / "box.obj", tmp_path / "scenes" / "scene.xml"
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    mesh.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "f 1 2 3\nf 5 6 7\nf 1 5 8\n")
    file.write_text(f'<mujoco><asset><mesh name="m" file="{mesh}"/></asset><worldbody/></mujoco>')
    with pytest.raises(SceneError, match="folder=DIR"):
        load_spec(file)
    assert compile_spec(load_spec(file, tmp_path)).nmesh == 1
    with pytest.raises(SceneError, match="only files below"):
        load_spec(file, file.parent)


def test_meshes_of_mujoco_count_what_their_heads_say():
    head = np.array([10, 30, 20, 5], dtype="<i4").tobytes()
    assert mesh_weight(head + bytes(4 * (30 + 90 + 40 + 15)), ".msh") == 15
    assert mesh_weight(np.array([2**30, 0, 0, -5], dtype="<i4").tobytes() + bytes(24), ".msh") <= 3
    assert mesh_weight(b"short", ".msh") == 0


@pytest.mark.parametrize("encoding", ["utf-7", "utf-16", "latin-1", "cp1252", "nonsense", "x" * 1000])
def test_other_encodings_than_that_of_mujoco_are_refused(encoding, tmp_path):
    text = f'<?xml version="1.0" encoding="{encoding}"?><mujoco/>'
    with pytest.raises(SceneError, match="encoding"):
        gp.Scene.from_mjcf(text, robot="arm/", tool="tool")
    (tmp_path / "a.xml").write_text(text)
    with pytest.raises(SceneError, match=r"a\.xml:1: the encoding"):
        gp.Scene.from_mjcf(tmp_path / "a.xml", robot="arm/", tool="tool")


def test_text_in_another_encoding_than_utf_8_is_refused(tmp_path):
    (tmp_path / "a.xml").write_bytes("<mujoco model='é'/>".encode("utf-16"))
    with pytest.raises(SceneError, match=r"a\.xml"):
        gp.Scene.from_mjcf(tmp_path / "a.xml", robot="arm/", tool="tool")


_PAINTED = """<mujoco><compiler inertiagrouprange="{}"/>
  <default><geom material="wood"/></default>
  <asset><texture name="t" type="2d" file="{}"/><material name="wood" texture="t"/>
    <mesh name="look" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>
  <worldbody><site name="spot" material="wood"/><body name="cup"><freejoint/>
    <geom name="wall" size=".05"/><geom name="skin" size=".1" group="1" contype="0" conaffinity="0"/>
    <geom name="handle" type="mesh" mesh="look" group="1" contype="0" conaffinity="0"/>
    <geom name="listed" size=".02" contype="0" conaffinity="0"/></body>
    <body name="plate"><geom name="rim" size=".05"/></body></worldbody>
  <contact><pair geom1="listed" geom2="rim"/></contact></mujoco>"""


@pytest.mark.parametrize("door", ["file", "text", "spec"])
def test_visuals_are_left_out_by_every_door(tmp_path: Path, door: str) -> None:
    text = _PAINTED.format("0 0", "/elsewhere/huge.png")
    file = _write(tmp_path, "world.xml", text)
    source = {"file": file, "text": text, "spec": mujoco.MjSpec.from_string(text)}[door]
    model = compile_spec(load_spec(source, visuals=False))
    names = {model.geom(k).name for k in range(model.ngeom)}
    assert names == {"wall", "listed", "rim"}
    assert (model.ntex, model.nmat, model.nmesh) == (0, 0, 0)
    with pytest.raises(SceneError):
        compile_spec(load_spec(source))


def test_bodies_weigh_the_same_without_visuals() -> None:
    text = re.sub("<texture.*?/>", '<texture name="t" type="2d" builtin="flat" width="4" height="4"/>', _PAINTED)
    for counted in ("0 0", "0 5"):
        seen, unseen = (compile_spec(load_spec(text.format(counted), visuals=look)) for look in (True, False))
        cup = seen.body("cup").id
        np.testing.assert_allclose(unseen.body_mass[cup], seen.body_mass[cup], rtol=1e-9)
        np.testing.assert_allclose(unseen.body_inertia[cup], seen.body_inertia[cup], rtol=1e-9)


def test_textures_beyond_the_budget_do_not_matter_without_visuals(tmp_path: Path) -> None:
    (tmp_path / "huge.png").write_bytes(_png(20_000, 20_000))
    file = _write(tmp_path, "world.xml", _PAINTED.format("0 0", "huge.png"))
    assert "visuals=False" in _refusal(file).message
    assert compile_spec(load_spec(file, visuals=False)).ngeom == 3
    drawn = "".join(f'<texture name="t{k}" builtin="flat" width="4096"/>' for k in range(40))
    assert compile_spec(load_spec(f"<mujoco><asset>{drawn}</asset></mujoco>", visuals=False)).ntex == 0


def test_meshes_that_do_not_collide_are_screened_all_the_same(tmp_path: Path) -> None:
    """Their inertia may be needed, so that MuJoCo reads them."""
    (tmp_path / "fine.obj").write_bytes(b"v 0 0 0" + b"\nv 0 0 0" * 1_000_000 + b"\nf 1 2 3")
    text = """<mujoco><asset><mesh name="m" file="fine.obj"/></asset><worldbody><body>
      <geom type="mesh" mesh="m" contype="0" conaffinity="0"/></body></worldbody></mujoco>"""
    with pytest.raises(SceneError, match=r"fine\.obj"):
        load_spec(_write(tmp_path, "world.xml", text), visuals=False)
