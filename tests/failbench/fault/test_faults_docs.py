"""docs/faults.md agrees with the classes, and its example of a custom fault runs."""

import dataclasses
import re
import sys

import pytest
import yaml
from breaking import Record, healthy_run
from places import LIBRARY, ROOT

from failbench.fault.registry import DEGREES, faults, from_document, load_class, reactions, to_document
from graceful_plan.costs.fault_prior import shipped_effects

TEXT = (ROOT / "docs" / "faults.md").read_text()
PRIOR = (ROOT / "docs" / "faults-prior.md").read_text()
EXAMPLE = ROOT / "examples" / "custom_fault.py"


def rows(known=None):
    """Return the rows of a table of faults: name, mechanism, parameter, four values, targets."""
    known = faults() if known is None else known
    cells = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in TEXT.splitlines() if line.startswith("|")
    ]
    return {row[0]: row for row in cells if len(row) == 8 and row[0] in known}


def test_every_fault_is_in_the_table_in_order():
    assert list(rows()) == list(faults())


@pytest.mark.parametrize("name", list(faults()))
def test_table_has_the_values_of_the_class(name):
    fault, row = faults()[name], rows()[name]
    assert [float(value) for value in row[3:7]] == [fault.AMOUNTS[degree] for degree in DEGREES]
    assert row[7] == fault.TARGETS[0]
    unit = re.search(r"\[(.*)\]", row[2])
    assert unit is None or unit.group(0) in fault.PARAMETER


def test_table_of_reactions_has_the_values_of_the_class():
    ((name, row),) = rows(reactions()).items()
    assert [float(value) for value in row[3:7]] == [reactions()[name].AMOUNTS[degree] for degree in DEGREES]
    assert row[7] == reactions()[name].TARGETS[0]


@pytest.mark.parametrize("name", list(faults()))
def test_mechanisms_name_the_written_fields(name):
    fields = " ".join(faults()[name].FIELDS)
    for word in re.findall(r"`(\w+)`", rows()[name][1]):
        assert word in fields


def test_ramps_and_durations_equal_those_of_the_classes():
    (line,) = [line for line in TEXT.splitlines() if line.startswith("| `ramp` |")]
    said = {name: float(s) for s, names in re.findall(r"([\d.]+) s: ([\w, ]+)", line) for name in names.split(", ")}
    assert said == {name: fault().ramp for name, fault in faults().items() if fault().ramp > 0.0}
    assert faults()["voltage_drop"]().duration == 0.2
    assert {fault().duration for name, fault in faults().items() if name != "voltage_drop"} == {None}


def test_snippets_run():
    names = {}
    for snippet in re.findall(r"^```python\n(.*?)^```", TEXT, flags=re.MULTILINE | re.DOTALL):
        exec(compile(snippet, "docs/faults.md", "exec"), names)


def held_out():
    """Return the skill of each fault's effects in held-out scenes."""
    document = yaml.safe_load((LIBRARY / "costs" / "fault_effects.yaml").read_text())
    return document["provenance"]["held_out"]


def test_the_table_of_skill_equals_the_calibration():
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in PRIOR.splitlines() if line[:1] == "|"]
    table = [tuple(row) for row in cells if len(row) == 5 and row[0] in faults()]
    expected = sorted(held_out().items(), key=lambda item: -item[1]["brier_skill"])
    assert set(held_out()) == set(faults())
    assert table == [
        (name, f"{x['happened']} of {x['events']}", *(f"{x[key]:.2f}" for key in ("brier_skill", "auc", "ratio")))
        for name, x in expected
    ]


def test_the_text_counts_the_well_predicted_faults():
    well = {name for name, x in held_out().items() if x["brier_skill"] >= 0.3}
    assert f"{len(well)} of {len(faults())} faults" in PRIOR
    shares = shipped_effects()
    assert all(shares[name]["drop"] > 0.5 for name in well)  # the document says "those with which the object is lost"


def test_links_lead_somewhere():
    for link in re.findall(r"\]\(([^)#:]+)\)", TEXT):
        assert (ROOT / "docs" / link).exists(), link


@pytest.mark.long
def test_example_of_an_own_fault_runs(capsys):
    cls = load_class(f"{EXAMPLE}:Runaway")
    rollouts = sys.modules[cls.__module__].main(count=6)
    assert len(rollouts) == 6
    assert {rollout.status for rollout in rollouts} == {"completed"}
    assert re.match(r"\d of 6 failures touched something", capsys.readouterr().out)


def test_own_fault_runs_away_both_ways_and_has_a_json_form():
    cls = load_class(f"{EXAMPLE}:Runaway")
    fault = cls(degree="critical", targets=(healthy_run().world.robot.joints[0],))
    back = dataclasses.replace(fault, backwards=True)
    assert from_document(to_document(back), {"runaway": cls}) == back

    assert Record(fault).qd[:, 0].max() > 1.0
    assert Record(back).qd[:, 0].min() < -1.0
