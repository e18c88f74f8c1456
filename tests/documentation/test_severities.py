"""The table of severities in docs/faults-prior.md equals the shipped values."""

import re

import yaml
from places import LIBRARY, ROOT

from graceful_plan.scene.harm.severity import SCALE, SeverityTable

SHIPPED = (LIBRARY / "scene" / "harm" / "severity.yaml").read_text()
SECTION = (ROOT / "docs" / "faults-prior.md").read_text().split("## Severities")[1].split("\n## ")[0]
ROWS = [[cell.strip() for cell in line.strip("|").split("|")] for line in SECTION.splitlines() if line[:1] == "|"]
HEADS = [row for row in ROWS if row[0] == "entity class"]
ROBOT, CONTENTS = (
    {row[0].strip("`"): row[1:] for row in ROWS if row[0].startswith("`") and len(row) == len(head)} for head in HEADS
)


def test_columns_are_the_component_classes():
    (_, *robot), (_, _, *contents) = HEADS
    assert [name.replace(" ", "_") for name in robot + contents] == yaml.safe_load(SHIPPED)["components"]


def test_rows_are_the_entity_classes_with_their_values():
    cells = {name: [*ROBOT[name], *contents] for name, (_, *contents) in CONTENTS.items()}
    shown = {name: [None if x == "–" else float(x) for x in row] for name, row in cells.items()}
    assert shown == yaml.safe_load(SHIPPED)["entities"]
    assert list(shown) == list(ROBOT) == list(SeverityTable.shipped().classes)


def test_notes_equal_those_of_the_file():
    notes = dict(re.findall(r"^  (\w+): +\[.*\] +# (.*)$", SHIPPED, flags=re.MULTILINE))
    assert {name: row[0] for name, row in CONTENTS.items()} == dict.fromkeys(CONTENTS, "") | {
        name: note.partition(";")[0] for name, note in notes.items()
    }


def test_the_scale_equals_that_of_the_file():
    (scale,) = re.findall(r"Scale: (.*?)Values apply", SHIPPED, flags=re.DOTALL)
    shown = [row[0] for row in ROWS if len(row) == 3 and row[0][:1].isdigit()]
    assert shown == re.findall(r"\b\d[\d.]*\b(?! USD)", scale)
    assert [str(value) for value in SCALE] == [
        value.removesuffix(".0") + ".0" * ("." not in value) for value in shown[1:]
    ]
