import dataclasses

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.annotation.agreement import compared, severity_row
from graceful_plan.annotation.annotations import Annotation, Annotations
from graceful_plan.exceptions import SceneError, SettingError, UnknownNameError
from graceful_plan.scene.elements import Liquid
from graceful_plan.scene.harm.fragility import FragilityTable
from graceful_plan.scene.harm.severity import SeverityTable
from support.annotation.model_server import rows

TABLE = SeverityTable.shipped()


def annotations(*names, **changes):
    found = {}
    for name, row in rows(names).items():
        category = row.pop("class")
        found[name] = Annotation(category=category, **{**row, **changes})
    return Annotations(scene="room", model="m", endpoint="http://localhost/v1", pictures=True, rows=found)


def test_a_file_is_read_back_as_it_was(tmp_path):
    said = annotations("floor", "vase", "mug", "yes", "3", "a: b", "null", "Glas ß")
    said.save(tmp_path / "s.yaml")
    assert Annotations.load(tmp_path / "s.yaml") == said
    assert (tmp_path / "s.yaml").read_text().count("\n") < 70  # a row of severities is a line


@settings(max_examples=8)
@given(st.text(max_size=30).map(lambda text: " ".join(text.split())))
def test_any_reason_and_model_is_read_back(tmp_path_factory, text):
    file = tmp_path_factory.getbasetemp() / "reason.yaml"
    printable = "".join(c for c in text if c.isprintable())
    said = dataclasses.replace(annotations("vase", reason=printable), model="m " + printable)
    said.save(file)
    assert Annotations.load(file) == said


def test_manual_changes_count(tmp_path, room):
    annotations("vase").save(tmp_path / "s.yaml")
    text = (tmp_path / "s.yaml").read_text()
    (tmp_path / "s.yaml").write_text(text.replace("arm_collapse: 15.0", "arm_collapse: 77"))
    changed = Annotations.load(tmp_path / "s.yaml").apply(room)
    assert changed.entities["vase"].severity == {"body": 77.0}
    assert changed.entities["vase"].category == "glass"
    assert changed.entities["mug"].severity == room.entities["mug"].severity
    assert changed.model is room.model


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("class: glass", "class: china", "unknown entity class 'china'; valid: adult"),
        ("class: glass", "class: carried", "unknown entity class 'carried'"),
        ("class: glass", "", "needs the key 'class'"),
        ("hot: 3.0", "lava: 3.0", "unknown component class 'lava'"),
        ("hot: 3.0", "hot: -3.0", "severity of hot = -3.0"),
        ("hot: 3.0", "hot: .nan", "is not finite"),
        ("hot: 3.0", "hot: very", "has to be a number"),
        ("fragility: 0.55", "fragility: 0", "fragility = 0.0, expected"),
        ("significance: 0.3", "significance: 2", "significance = 2.0, expected a number from 0 to 1"),
        ("  reason: ", "  wisdom: ", "unknown key 'wisdom'"),
        ("version: 1", "version: 2", "only version 1 of annotations"),
        ("pictures: true", "pictures: 3", "has to be true or false"),
        ("model: m", "model: !!python/object:os.system m", "tag .* is not allowed"),
        ("model: m", "model: &a m", "anchors"),
    ],
)
def test_broken_files_are_refused_with_the_line(tmp_path, old, new, message):
    annotations("vase").save(tmp_path / "s.yaml")
    text = (tmp_path / "s.yaml").read_text()
    assert old in text
    (tmp_path / "s.yaml").write_text(text.replace(old, new))
    with pytest.raises(SceneError, match=message) as caught:
        Annotations.load(tmp_path / "s.yaml")
    assert caught.value.file == str(tmp_path / "s.yaml")


def test_severities_may_be_left_out_and_come_from_the_class(tmp_path, room):
    annotations("vase").save(tmp_path / "s.yaml")
    text = (tmp_path / "s.yaml").read_text()
    (tmp_path / "s.yaml").write_text(text.replace("arm_collapse: 15.0, ", "").replace("class: glass", "class: child"))
    changed = Annotations.load(tmp_path / "s.yaml").apply(room)
    assert changed.entities["vase"].severity == {"body": TABLE.severity("child", "arm_collapse")}


def test_entities_of_another_scene_are_refused(room):
    with pytest.raises(UnknownNameError, match=r"'teapot'.*floor, inside, mug, vase"):
        annotations("teapot").apply(room)
    rows = {category: {"arm_collapse": 1.0} for category in ("floor", "heirloom", "glass", "robust")}
    with pytest.raises(UnknownNameError, match="'arm_braked'"):
        annotations("vase").apply(room.with_severity(SeverityTable(rows, ("arm_collapse",))))


@pytest.mark.parametrize(("field", "value"), [("fragility", 0.0), ("fragility", float("nan")), ("significance", -0.1)])
def test_numbers_out_of_range_are_refused(field, value):
    with pytest.raises(SettingError, match=field):
        annotations("vase", **{field: value})


def test_annotations_hold_for_objects_carried_later(room):
    changed = annotations("vase", "mug").apply(room)
    full = changed.attach("mug", X_TO=gp.FROM_ABOVE, object_class="light")
    assert full.entities["vase"].severity == {"body": 15.0, "carried": 5.0}
    assert "mug" not in full.entities
    assert annotations("vase").apply(full).entities["vase"].severity == {"body": 15.0, "carried": 5.0}


def test_earlier_annotations_are_replaced(room):
    before = room.with_severity({"vase": 99.0, "mug": 98.0})
    after = annotations("vase").apply(before)
    assert (after.entities["vase"].severity["body"], after.entities["mug"].severity["body"]) == (15.0, 98.0)


def test_the_most_fragile_of_a_class_counts():
    said = annotations("vase", "mug", "person")
    row = dataclasses.replace(said.rows["mug"], fragility=0.2)
    table = dataclasses.replace(said, rows={**said.rows, "mug": row}).fragility()
    shipped = FragilityTable.shipped()
    assert table.of("glass") == dataclasses.replace(shipped.of("glass"), median=0.2)
    assert table.of("floor") == shipped.of("floor") and table.carried == shipped.carried
    gp.ImpactCost(consequence=table)


def test_a_scene_agrees_with_itself(room):
    scene = room.with_severity({"vase": {"hot": 3.0}, "glass": {"light": 4.0}, "floor": 1.5})
    own = {
        name: Annotation(
            category=entity.category, fragility=1.0, significance=0.5, severity=severity_row(scene, name), reason="own"
        )
        for name, entity in scene.entities.items()
    }
    found = compared(Annotations(scene="", model="", endpoint="", pictures=False, rows=own), scene)
    assert (found.same_class, found.same_row, found.within_two) == (1.0, 1.0, 1.0)
    assert found.rank_correlation == pytest.approx(1.0) and found.entities == len(scene.entities)


def test_disagreement_is_counted(room):
    found = compared(annotations("floor", "vase"), room)  # the vase is an heirloom there
    assert (found.entities, found.same_class, found.same_row) == (2, 0.5, 0.5)
    heirloom, glass = TABLE.rows["heirloom"], TABLE.rows["glass"]
    close = [max(heirloom[c], glass[c]) <= 2.0 * min(heirloom[c], glass[c]) for c in TABLE.components]
    assert found.within_two == pytest.approx((sum(close) + len(TABLE.components)) / (2 * len(TABLE.components)))
    assert 0.0 < found.rank_correlation < 1.0
    assert compared(annotations("floor", severity={"hot": 1.0}), room).rank_correlation is None
    with pytest.raises(UnknownNameError, match="'teapot'"):
        compared(annotations("teapot"), room)


def test_rows_of_a_scene_reach_its_components(room):
    scene = room.with_severity({"vase": {"carried": 4.0, "sharp": 9.0, "oil": 3.0}, "mug": 2.0, "floor": {"hot": 7.0}})
    assert set(severity_row(scene, "mug").values()) == {2.0}
    row = severity_row(scene, "vase")
    assert (row["sharp"], row["light"], row["oil"], row["arm_collapse"]) == (4.0, 4.0, 3.0, 30.0)
    carried = scene.attach("mug", X_TO=gp.FROM_ABOVE, object_class="sharp", contents=None)
    assert carried.entities["vase"].severity == {"body": row["arm_collapse"], "carried": row["sharp"]}
    assert severity_row(scene, "floor")["hot"] == 7.0
    assert Liquid(1.0).component_class == "cold"
