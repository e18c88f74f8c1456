"""YAML of strangers: plain values, in linear time, or a FormatError."""

import math

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from graceful_plan import untrusted_yaml
from graceful_plan.exceptions import FormatError, SceneError
from graceful_plan.untrusted_yaml import parse_yaml_values
from graceful_plan.yaml_file import parse_yaml

_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63) | st.floats(allow_nan=False)
    | st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"])),
    lambda inside: st.lists(inside, max_size=3) | st.dictionaries(st.text("ab", min_size=1), inside, max_size=3),
    max_leaves=8,
)  # fmt: skip


@given(_VALUES)
def test_what_yaml_writes_is_read(value):
    assert parse_yaml_values(yaml.safe_dump(value), "a") == value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("", None),
        ("1e-05", 1e-05),
        ("-1E3", -1000.0),
        (".5", 0.5),
        ("5.", 5.0),
        ("0x1F", 31),
        ("0o17", 15),
        ("010", 10),
        ("+3", 3),
        ("-.inf", -math.inf),
        ("~", None),
        ("TRUE", True),
        ("on", "on"),
        ("12:30:00", "12:30:00"),
        ("2020-01-01", "2020-01-01"),
        ("'5'", "5"),
        ('"true"', "true"),
        ("|\n  5\n", "5\n"),
        ("1_000", "1_000"),
        ("%YAML 1.2\n---\n3\n", 3),
        ("a: 1\n---\n", {"a": 1}),
        ("1: 2", {1: 2}),
        ("9" * 65, "9" * 65),
    ],
)
def test_scalars_follow_the_core_schema(text, value):
    found = parse_yaml_values(text, "a")
    assert found == value and type(found) is type(value)


def test_nan_is_a_number():
    assert math.isnan(parse_yaml_values(".nan", "a"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: &x 1", "anchors and aliases"),
        ("[&x 1, *x]", "anchors and aliases"),
        ("{<<: {a: 1}}", "merged mappings"),
        ("!!python/object:os.x {}", "the tag"),
        ("!!int 5", "the tag"),
        ("%TAG !a! b\n--- 1", "the directive '%TAG !a! b'"),
        ("{a: 1, a: 2}", "the key 'a' appears twice"),
        ("? [1, 2]\n: 3", "a key is not a text or number"),
        ("1\n---\n2", "more than one document"),
        ("1\n---\n---\n", "more than one document"),
        ("[" * 30 + "]" * 30, "nested deeper"),
        ("a: [", "broken YAML in line"),
        ("a: \x00", "broken YAML"),
    ],
)
def test_the_rest_is_refused_by_name(text, said):
    with pytest.raises(FormatError, match=said) as caught:
        parse_yaml_values(text, "file.yaml")
    assert str(caught.value).startswith("file.yaml: ")


def test_too_many_values_are_refused(monkeypatch):
    monkeypatch.setattr(untrusted_yaml, "MOST_VALUES", 10)
    assert len(parse_yaml_values("[1, 2, 3, 4, 5, 6, 7, 8, 9]", "a")) == 9
    with pytest.raises(FormatError, match="more than 10 values"):
        parse_yaml_values("[1, 2, 3, 4, 5, 6, 7, 8, 9, 10]", "a")


def test_names_of_tags_are_refused_in_scene_files_as_well():
    with pytest.raises(SceneError, match="the directive"):
        parse_yaml("%TAG !a! b\n---\na: 1", "scene.yaml")


@pytest.mark.parametrize(
    "text",
    [
        "{" + ", ".join(["<<: {}"] * 200_000) + "}",
        "a: " + "1:" * 500_000 + "1",
        "".join(f"%TAG !a{i}! b\n" for i in range(60_000)) + "--- 1",
        "[" + ", ".join(["9" * 4000] * 400) + "]",
    ],
    ids=["merged", "base 60", "tags", "integers"],
)
def test_texts_that_took_quadratic_time_end(text):
    """Each took from ten seconds to minutes."""
    try:
        parse_yaml_values(text, "a")
    except FormatError:
        pass
