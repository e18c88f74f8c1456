import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from graceful_plan.annotation.answers import read_answer
from graceful_plan.exceptions import AnnotationError
from graceful_plan.scene.harm.severity import SeverityTable
from support.annotation.model_server import rows

TABLE = SeverityTable.shipped()
NAMES = ["vase", "person"]


def answer(**changes):
    """Return an answer about both entities, with fields of the vase replaced; None removes one."""
    found = rows(NAMES)
    found["vase"] |= changes
    found["vase"] = {field: value for field, value in found["vase"].items() if value is not None}
    return json.dumps({"entities": found})


def severity(**changes):
    return {"severity": rows(["vase"])["vase"]["severity"] | changes}


def test_an_answer_is_read_in_the_order_of_the_question():
    found = read_answer(answer(), NAMES[::-1], TABLE)
    assert list(found) == ["person", "vase"]
    assert found["person"].category == "adult" and found["person"].significance == 1.0
    assert found["vase"].severity == rows(["vase"])["vase"]["severity"]


@pytest.mark.parametrize("form", ["{}", "```json\n{}\n```", "Here it is:\n{}\nIs that fine?"])
def test_words_around_the_object_do_not_matter(form):
    assert read_answer(form.replace("{}", answer()), NAMES, TABLE) == read_answer(answer(), NAMES, TABLE)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("I cannot help with that.", "it has no JSON object"),
        ("}{", "it has no JSON object"),
        ("{not json}", "it is not JSON"),
        ('{"entities": [1]}', "it has no object 'entities'"),
        ('{"vase": {}}', "it has no object 'entities'"),
        ('{"entities": {"vase": 1, "vase": 2}}', "the key 'vase' stands twice"),
        ('{"entities": ' + "[" * 100_000 + "]" * 100_000 + "}", "it is not JSON"),
        (answer().replace('"entities"', '"entities": {}, "entities"'), "the key 'entities' stands twice"),
        (answer(fragility=math.nan), "NaN is no number"),
        (answer(significance=math.inf), "Infinity is no number"),
        ('{"entities": {"vase": ' + "9" * 10_000 + "}}", "it is not JSON"),
        (answer(**{"class": "china"}), "entity 'vase': unknown class 'china'; valid: adult_head, adult, "),
        (answer(**{"class": "carried"}), "entity 'vase': unknown class 'carried'"),
        (answer(**{"class": ["glass"]}), r"entity 'vase': unknown class \['glass'\]"),
        (answer(fragility=0), "entity 'vase': fragility 0 is no number above 0"),
        (answer(fragility=-1.0), "entity 'vase': fragility -1.0"),
        (answer(fragility=1e6), "entity 'vase': fragility 1000000.0"),
        (answer(fragility="1 J"), "entity 'vase': fragility '1 J'"),
        (answer(fragility=True), "entity 'vase': fragility True"),
        (answer(fragility=10**400), "entity 'vase': fragility 1000"),
        (answer(significance=1.5), "entity 'vase': significance 1.5 is no number from 0 to 1"),
        (answer(reason=""), "entity 'vase': the reason has to be a text"),
        (answer(reason="x" * 2000), "entity 'vase': the reason has to be a text"),
        (answer(reason=3), "entity 'vase': the reason has to be a text"),
        (answer(reason=None), "entity 'vase': 'reason' is missing"),
        (answer(severity=None), "entity 'vase': 'severity' is missing"),
        (answer(colour="blue"), "entity 'vase': unknown field 'colour'; valid: class, "),
        (answer(severity=[1, 2]), "entity 'vase': severity has to be an object"),
        (answer(**severity(hot=101)), "entity 'vase': severity of 'hot', 101, is no number from 0 to 100"),
        (answer(**severity(hot=-1)), "severity of 'hot', -1"),
        (answer(**severity(hot=None)), "severity of 'hot', None"),
        (answer(**severity(laser=1)), "severity has an unknown column 'laser'; valid: arm_collapse, "),
        (answer(severity={"hot": 1}), "severity has no column 'arm_collapse'"),
        (answer().replace("1.0", "1e999"), "entity 'person': significance inf"),
    ],
)
def test_errors_name_the_culprits(text, problem):
    with pytest.raises(AnnotationError, match=problem) as caught:
        read_answer(text, NAMES, TABLE)
    assert caught.value.problems


def test_all_problems_are_kept_and_few_are_shown():
    with pytest.raises(AnnotationError, match="and 12 more") as caught:
        read_answer('{"entities": {}}', [f"thing{i}" for i in range(20)], TABLE)
    assert len(caught.value.problems) == 20


def test_reasons_are_one_printable_line():
    found = read_answer(answer(reason="a\nb\x1b[31m\u2028c"), NAMES, TABLE)
    assert found["vase"].reason == "a b [31m c"


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from([*NAMES, "class", "x"]), inner, max_size=3)
    ),
    max_leaves=8,
)


@given(st.sampled_from(["class", "fragility", "significance", "severity", "reason"]), JSON)
def test_any_field_is_read_or_refused(field, value):
    text = json.dumps({"entities": rows(NAMES) | {"vase": rows(["vase"])["vase"] | {field: value}}})
    try:
        found = read_answer(text, NAMES, TABLE)["vase"]
    except AnnotationError as error:
        assert error.problems
    else:
        assert 0.0 < found.fragility <= 1000.0 and 0.0 <= found.significance <= 1.0


@given(st.text(max_size=60))
def test_any_text_is_read_or_refused(text):
    with pytest.raises(AnnotationError):
        read_answer(text, NAMES, TABLE)
