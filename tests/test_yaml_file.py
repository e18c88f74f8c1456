from __future__ import annotations

import math
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from graceful_plan.exceptions import SceneError
from graceful_plan.yaml_file import MAX_DEPTH, Block, parse_yaml, read_yaml


def _refusal(text: str) -> SceneError:
    with pytest.raises(SceneError) as caught:
        parse_yaml(text, "a.yaml")
    return caught.value


def test_values_know_their_lines_and_names() -> None:
    root = parse_yaml("a: 1\nb:\n  c: [x, 2.5,\n      -1e-3]\n", "a.yaml")
    assert root["a"].number() == 1.0
    c = root["b"]["c"]
    assert (c.line, c.name) == (3, "a.yaml.b.c")
    assert [child.line for child in c.entries()] == [3, 3, 4]
    assert c.entries()[0].string() == "x"
    assert c.entries()[2].number() == -1e-3
    assert str(c.error("is odd")) == "a.yaml:3: is odd"


_REFUSED = {
    "bomb": ("a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n", 1, "anchors and aliases"),
    "merge": ("a: {b: 1}\nc:\n  <<: *a\n", 3, "anchors and aliases"),
    "object": ("a: 1\nb: !!python/object/apply:os.system [ls]\n", 2, "the tag tag:yaml.org,2002:python/object"),
    "own tag": ("a: !own 1\n", 1, "the tag !own is not allowed"),
    "binary": ("a: !!binary aGFsbG8=\n", 1, "binary is not allowed"),
    "deep": ("a: " + "[" * 1000 + "]" * 1000, 1, f"nested deeper than {MAX_DEPTH}"),
    "many": ("a: [" + "1," * 200_000 + "]", 1, "more than 100000 values"),
    "list": ("- 1\n- 2\n", 1, "has to be a mapping at its top"),
    "empty": ("", 1, "has to be a mapping at its top"),
    "twice": ("a: 1\nb: 2\na: 3\n", 3, "the key 'a' of a.yaml appears twice"),
    "number key": ("a:\n  1: 2\n", 2, "a key of a.yaml.a is not text; put it in quotes"),
    "yes key": ("a:\n  yes: 2\n", 2, "is not text"),
    "tab": ("a:\n\tb: 1\n", 2, "broken YAML"),
    "open": ("a: [1, 2\nb: 3\n", 2, "broken YAML"),
    "control character": ("a: \x07\n", None, "broken YAML"),
    "two documents": ("a: 1\n---\nb: 2\n", 2, "broken YAML"),
}


@pytest.mark.parametrize("attack", _REFUSED)
def test_hostile_files_are_refused(attack: str) -> None:
    text, line, words = _REFUSED[attack]
    error = _refusal(text)
    assert words in error.message
    assert (error.file, error.line) == ("a.yaml", line)


@pytest.mark.parametrize(
    ("text", "ask", "words"),
    [
        ("a: x", Block.number, "a.yaml.a has to be a number"),
        ("a: [1]", Block.number, "has to be a number"),
        ("a: true", Block.number, "has to be a number"),
        ("a: .inf", Block.number, "a.yaml.a is not finite"),
        ("a: -.Inf", Block.number, "is not finite"),
        ("a: .NaN", Block.number, "is not finite"),
        ("a: 1e999", Block.number, "is not finite"),
        ("a: 12", Block.string, "has to be text"),
        ("a: true", Block.string, "has to be text"),
        ("a: {b: 1}", Block.string, "has to be text"),
        ("a: 12", Block.entries, "has to be a list"),
        ("a: [1, x]", Block.numbers, r"a.yaml.a\[1\] has to be a number"),
        ("a: [1, 2]", lambda a: a.numbers(3), "has 2 numbers, expected 3"),
        ("a: [x, 2]", Block.strings, r"a.yaml.a\[1\] has to be text"),
        ("a: [1]", Block.items, "has to be a mapping"),
        ("a: {b: 1}", lambda a: a["c"], "a.yaml.a needs the key 'c'"),
        ("a: {b: ~}", lambda a: a["b"], "a.yaml.a needs the key 'b'"),
        ("a: {b: 1}", lambda a: a.only("c", "d"), "unknown key 'b' in a.yaml.a; valid: c, d"),
    ],
)
def test_errors_name_the_expected_type(text: str, ask: object, words: str) -> None:
    with pytest.raises(SceneError, match=words) as caught:
        ask(parse_yaml(f"z: 0\n{text}\n", "a.yaml")["a"])  # type: ignore[operator]
    assert caught.value.line == 2


def test_null_is_as_good_as_absent() -> None:
    root = parse_yaml("a: null\nb: ~\nc:\n", "a.yaml")
    assert [root.get(key) for key in "abcd"] == [None] * 4


def test_files(tmp_path: Path) -> None:
    file = tmp_path / "a.yaml"
    with pytest.raises(SceneError, match="No such file"):
        read_yaml(file)
    file.write_bytes(b"a: \xff\n")
    with pytest.raises(SceneError, match="is not UTF-8"):
        read_yaml(file)
    with file.open("wb") as stream:
        stream.truncate(2_000_000)
    with pytest.raises(SceneError, match=r"2000000.*1000000"):
        read_yaml(file)


def _plain(block: Block) -> object:
    if block.is_mapping:
        return {name: _plain(child) for name, child in block.items()}
    if block.is_list:
        return [_plain(child) for child in block.entries()]
    if block.is_null:
        return None
    return block.string() if block.is_string else block.number()


_KEYS = st.text("abcxyz_", min_size=1, max_size=5).filter(lambda key: key not in ("y", "n"))
_NUMBERS = st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(10**9), 10**9)
_TREES = st.recursive(
    st.none() | _NUMBERS | _KEYS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(_KEYS, inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=40, deadline=None)
@given(st.dictionaries(_KEYS, _TREES, max_size=3), st.sampled_from([True, False, None]))
def test_dumped_values_can_be_read(tree: dict, flow: bool | None) -> None:
    text = yaml.safe_dump(tree, default_flow_style=flow)
    if "&id" in text:
        assert "anchors" in _refusal(text).message
    else:
        assert _plain(parse_yaml(text, "a.yaml")) == tree


@settings(max_examples=60, deadline=None)
@given(st.text("ab:-[]{}&*!|>'\"#%@`,?~ \n\t1.", max_size=40))
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        value = _plain_or_nothing(parse_yaml(text, "a.yaml"))
    except SceneError:
        return
    assert isinstance(value, dict)


def _plain_or_nothing(block: Block) -> object:
    value = _plain(block)
    assert not (isinstance(value, float) and math.isnan(value))
    return value
