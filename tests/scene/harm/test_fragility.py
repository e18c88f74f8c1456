"""The table of fragilities: a distribution for every class, broken files."""

import pickle
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from graceful_plan import SeverityTable
from graceful_plan.exceptions import SceneError, SettingError
from graceful_plan.scene.elements import CARRIED_CLASSES
from graceful_plan.scene.harm import fragility
from graceful_plan.scene.harm.fragility import Fragility, FragilityTable
from graceful_plan.scene.harm.severity import ITSELF


@given(st.floats(1e-3, 1e3), st.floats(1e-6, 1e6), st.floats(1e-6, 1e6))
def test_fragility_is_a_distribution(median: float, a: float, b: float) -> None:
    row = Fragility(median, 0.5, 0.7)
    low, high = sorted((a, b))
    assert 0.0 <= row.probability(low) <= row.probability(high) <= 1.0
    assert row.probability(median) == pytest.approx(0.5)
    assert row.probability(0.0) == 0.0
    assert row.probability(median * 2.718281828459045**0.7) == pytest.approx(0.8413447, abs=1e-6)


def test_every_shipped_class_has_a_fragility() -> None:
    table, severity = FragilityTable.shipped(), SeverityTable.shipped()
    assert set(table.rows) == set(severity.classes) - {ITSELF}
    assert set(table.carried) == set(severity.rows[ITSELF]) == set(CARRIED_CLASSES)


def test_soft_surfaces_spare_falling_objects() -> None:
    table = FragilityTable.shipped()
    assert table.loss("glass", "floor", 0.55) == table.loss("glass", "", 0.55) == pytest.approx(0.5)
    assert table.loss("glass", "textile", 5.5) == pytest.approx(0.5)
    assert table.loss("sharp", "floor", 0.55) < table.loss("heavy", "floor", 0.55) < table.loss("glass", "floor", 0.55)
    own = FragilityTable({"mattress": Fragility(9.0, 0.0, 0.7, hardness=0.01)}, Fragility(2.0, 1.0, 0.7))
    assert own.loss("medium", "mattress", 200.0) == own.loss("heavy", "floor", 2.0) == pytest.approx(0.5)


def test_a_table_may_leave_the_carried_object_out(tmp_path: Path) -> None:
    text = (Path(fragility.__file__).parent / "fragility.yaml").read_text(encoding="utf-8")
    file = tmp_path / "fragility.yaml"
    file.write_text(text[: text.index("\ncarried:") + 1], encoding="utf-8")
    table = FragilityTable.load(file)
    assert not table.carried and table.of_carried("glass") == table.other
    assert table.rows == FragilityTable.shipped().rows


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("median: 0.55", "median: -1"), "median = -1.0, expected finite and above 0"),
        (("wetted: 0.5", "wetted: 2"), r"wetted = 2.0, expected in \[0, 1\]"),
        (("version: 1", "version: 2"), "only version 1"),
        (("other: ", "others: "), "unknown key 'others'"),
        (("median: 0.25", "mean: 0.25"), "unknown key 'mean'"),
        (("hardness: 0.1", "hardness: 0"), r"hardness = 0.0, expected in \(0, 1\]"),
        (("  sharp:  {", "  blunt:  {"), "unknown key 'blunt'"),
        (("heavy:  {median: 2.0}", "heavy:  {median: 2.0, wetted: 1}"), "unknown key 'wetted'"),
        (("heavy:  {median: 2.0}", "heavy:  {median: 0}"), "median = 0.0, expected finite and above 0"),
    ],
)
def test_broken_tables_are_refused(change: tuple[str, str], message: str, tmp_path: Path) -> None:
    text = (Path(fragility.__file__).parent / "fragility.yaml").read_text(encoding="utf-8")
    file = tmp_path / "fragility.yaml"
    file.write_text(text.replace(*change), encoding="utf-8")
    with pytest.raises(SceneError, match=message):
        FragilityTable.load(file)


@pytest.mark.parametrize("values", [{"median": 0.0}, {"spread": float("inf")}, {"wetted": -0.1}, {"hardness": 1.1}])
def test_fragility_out_of_range(values: dict[str, Any]) -> None:
    with pytest.raises(SettingError, match=next(iter(values))):
        Fragility(**({"median": 1.0, "wetted": 1.0, "spread": 0.7} | values))


def test_a_table_is_a_value() -> None:
    table = FragilityTable.shipped()
    twin = pickle.loads(pickle.dumps(table))
    assert twin == table and hash(twin) == hash(table) and twin is not table
    assert FragilityTable({}, table.other) != table != FragilityTable(table.rows, table.other)


def test_contents_do_not_ask_for_energy() -> None:
    table = FragilityTable({"laptop": Fragility(2.0, 0.3, 0.7)}, Fragility(1.0, 1.0, 0.7))
    assert table.probability("laptop", "contents", 0.0) == 0.3
    assert table.probability("laptop", "carried", 2.0) == pytest.approx(0.5)
    assert table.probability("vase", "body", 1.0) == pytest.approx(0.5)  # an unlisted class
