from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from graceful_plan.exceptions import SceneError, SettingError, UnknownNameError
from graceful_plan.scene.harm.severity import SeverityTable, check_severity

_TABLE = SeverityTable.shipped()


@pytest.mark.parametrize(
    ("category", "component", "severity"),
    [
        ("glass", "medium", 10.0),  # the published pair: red
        ("robust", "medium", 2.0),  # and white
        ("adult_head", "hot", 50.0),
        ("child", "arm_collapse", 100.0),
        ("mains", "cold", 30.0),
        ("textile", "light", 0.0),
        ("table", "light", 0.2),
        ("flame", "oil", 50.0),
        ("carried", "glass", 10.0),
    ],
)
def test_values_of_the_shipped_table(category: str, component: str, severity: float) -> None:
    assert _TABLE.severity(category, component) == severity


def test_the_shipped_table_lacks_only_meaningless_pairs() -> None:
    missing = {
        (category, c) for category in _TABLE.classes for c in _TABLE.components if c not in _TABLE.rows[category]
    }
    carried = {("carried", c) for c in ("arm_collapse", "arm_braked", "base_coast", "cold", "hot", "oil", "dry")}
    assert missing == {("adult_head", "base_coast"), ("table", "base_coast")} | carried
    assert len(_TABLE.classes) == 17
    assert len(_TABLE.components) == 12


def test_class_none_never_counts() -> None:
    assert all(_TABLE.severity("none", c) == 0.0 for c in _TABLE.components)


def test_humans_suffer_more_from_worse() -> None:
    for category in ("adult_head", "adult", "child", "pet"):
        row = _TABLE.rows[category]
        assert row["light"] <= row["medium"] <= row["heavy"]
        assert row["cold"] <= row["hot"] <= row["oil"]
        assert row["arm_braked"] <= row["arm_collapse"]


def test_an_undefined_pair_lists_the_defined_ones() -> None:
    with pytest.raises(SceneError, match=r"'base_coast'.*'table'.*arm_braked.*dry"):
        _TABLE.severity("table", "base_coast")


def test_unknown_names_list_the_valid_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"'unicorn'.*adult, .*textile"):
        _TABLE.severity("unicorn", "medium")
    with pytest.raises(UnknownNameError, match=r"'huge'.*arm_braked"):
        _TABLE.severity("glass", "huge")
    with pytest.raises(UnknownNameError, match="'huge'"):
        _TABLE.with_overrides({"glass": {"huge": 1.0}})


def test_overrides_make_a_new_table() -> None:
    changed = _TABLE.with_overrides({"glass": {"medium": 7.0}, "paper": 3.0, "cactus": {"light": 4.0}})
    assert changed.severity("glass", "medium") == 7.0
    assert changed.severity("glass", "light") == 5.0
    assert {changed.severity("paper", c) for c in changed.components} == {3.0}
    assert changed.severity("cactus", "light") == 4.0
    assert _TABLE.severity("glass", "medium") == 10.0
    assert "cactus" not in _TABLE.classes


def test_a_table_cannot_be_written_to() -> None:
    with pytest.raises(TypeError):
        _TABLE.rows["glass"]["medium"] = 0.0  # type: ignore[index]


@pytest.mark.parametrize("value", [-1, float("nan"), float("inf"), 1e308, "2", None, True, [1]])
def test_bad_severities_are_refused(value: object) -> None:
    with pytest.raises(SettingError, match="harm = "):
        check_severity("harm", value)


_HEAD = "version: 1\ncomponents: [light, heavy]\nentities:\n"


def _write(folder: Path, text: str) -> Path:
    file = folder / "table.yaml"
    file.write_text(text)
    return file


def test_a_custom_table(tmp_path: Path) -> None:
    table = SeverityTable.load(_write(tmp_path, _HEAD + "  vase: [1, 20]\n  rug: [null, 1e0]\n"))
    assert table.severity("vase", "heavy") == 20.0
    assert table.severity("rug", "heavy") == 1.0
    with pytest.raises(SceneError, match=r"'light'.*'rug'"):
        table.severity("rug", "light")


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("version: 2\ncomponents: []\nentities: {}\n", 1, "only version 1"),
        (_HEAD + "  vase: [1]\n", 4, "vase has 1 severities for 2 component classes"),
        (_HEAD + "  vase: [1, -2]\n", 4, "a severity of vase is below 0"),
        (_HEAD + "  vase: [1, .nan]\n", 4, "not finite"),
        (_HEAD + "  vase: [1, 1e999]\n", 4, "not finite"),
        (_HEAD + "  vase: [1, many]\n", 4, "has to be a number"),
        (_HEAD + "  vase: 3\n", 4, "has to be a list"),
        (_HEAD + "  vase: [1, 2]\ncolour: red\n", 5, r"unknown key 'colour'.*valid: version, components, entities"),
        (_HEAD + "  vase: &a [1, 2]\n  jar: *a\n", 4, "anchors and aliases"),
        ("version: 1\nentities: {}\n", 1, "needs the key 'components'"),
    ],
)
def test_errors_of_broken_tables_name_the_place(tmp_path: Path, text: str, line: int, words: str) -> None:
    with pytest.raises(SceneError, match=words) as caught:
        SeverityTable.load(_write(tmp_path, text))
    assert caught.value.line == line
    assert caught.value.file == str(tmp_path / "table.yaml")


@given(st.floats(0.0, 1e6), st.sampled_from(_TABLE.classes), st.sampled_from(_TABLE.components))
def test_overrides_are_returned(value: float, category: str, component: str) -> None:
    changed = _TABLE.with_overrides({category: {component: value}})
    assert changed.severity(category, component) == value
    for other in changed.rows[category]:
        assert other == component or changed.severity(category, other) == _TABLE.severity(category, other)
