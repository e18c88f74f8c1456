"""The table of severities in docs/faults-prior.md has the shipped values."""

import math
import re

import pytest
import yaml
from places import LIBRARY, ROOT

from graceful_plan.scene.harm.severity import SeverityTable

SHIPPED = (LIBRARY / "scene" / "harm" / "severity.yaml").read_text()
SECTION = (ROOT / "docs" / "faults-prior.md").read_text().split("## Severities")[1].split("\n## ")[0]
ROWS = [[cell.strip() for cell in line.strip("|").split("|")] for line in SECTION.splitlines() if line[:1] == "|"]
(HEAD,) = [row for row in ROWS if row[0] == "entity class"]
ENTITIES = {row[0].strip("`"): row[1:] for row in ROWS if row[0].startswith("`")}


def test_columns_are_the_component_classes():
    assert [cell.strip("`") for cell in HEAD[2:]] == yaml.safe_load(SHIPPED)["components"]


def test_rows_are_the_entity_classes_with_their_values():
    shown = {name: [None if x == "–" else float(x) for x in values] for name, (_, *values) in ENTITIES.items()}
    assert shown == yaml.safe_load(SHIPPED)["entities"]
    assert list(shown) == list(SeverityTable.shipped().classes)


def test_notes_are_those_of_the_file():
    notes = dict(re.findall(r"^  (\w+): +\[.*\] +# (.*)$", SHIPPED, flags=re.MULTILINE))
    assert {name: row[0] for name, row in ENTITIES.items()} == dict.fromkeys(ENTITIES, "") | {
        name: note.partition(";")[0] for name, note in notes.items()
    }


def test_the_scale_is_that_of_the_file():
    scale = [float(row[0]) for row in ROWS if len(row) == 3 and re.fullmatch(r"[\d.]+", row[0])]
    head = re.sub(r"(?<!\d)[\d.]+ (?:to [\d.]+ )?(?:USD|m\b|kg)|of 0.3", "", SHIPPED.split("Values apply")[0])
    assert scale == [float(x) for x in re.findall(r"(?<![\d.])\d+(?:\.\d+)?", head)]
    assert math.isclose(max(scale), max(x for row in SeverityTable.shipped().rows.values() for x in row.values()))


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_rows_are_complete(row):
    assert len(row) in (3, len(HEAD))
