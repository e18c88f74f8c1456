import pytest
from bench_cases import planner_file

import graceful_plan as gp
from graceful_plan import SettingError, UnknownNameError
from graceful_plan.compare.runs.planner_file import read_planners
from graceful_plan.exceptions import FormatError


def labels(*args, **kwargs):
    return [note.label for note in read_planners(*args, **kwargs)]


def test_all_planners_unless_named():
    assert labels(None) == list(gp.PLANNERS)
    assert labels(["rrt_star", "anytime"]) == ["rrt_star", "anytime"]


def test_settings_are_given_by_name():
    (note,) = read_planners(["rrt_star:range=0.4"])
    assert note.make() == gp.RRTStar(range=0.4)
    assert note.to_document() == {"label": "rrt_star:range=0.4", "name": "rrt_star", "settings": {"range": 0.4}}
    (small,) = read_planners(["rrt_star:range=4e-1"])
    assert small.make() == gp.RRTStar(range=0.4)
    (default,) = read_planners(["rrt_star:range=null"])
    assert default.make() == gp.RRTStar(range=None)


@pytest.mark.parametrize(
    ("word", "error", "message"),
    [
        ("hope", UnknownNameError, "unknown planner 'hope'; valid: anytime"),
        ("rrt_star:hope=1", UnknownNameError, "unknown setting of planner rrt_star 'hope'; valid: .*range"),
        ("rrt_star:range", SettingError, "name:setting=value"),
        ("rrt_star:", SettingError, "name:setting=value"),
        ("rrt_star:range=-1.0", SettingError, "range = -1.0"),
        ("rrt_star:range=wide", SettingError, "planner = 'rrt_star:range=wide', expected settings that it takes"),
        ("rrt_star:range=[1]", SettingError, "a number, a word, true, false or null"),
        ("rrt_star:range=1,range=2", SettingError, "every setting once"),
    ],
)
def test_what_is_wrong_with_a_planner_is_said_early(word, error, message):
    with pytest.raises(error, match=message):
        read_planners([word])


def test_planners_are_compared_once():
    with pytest.raises(SettingError, match="every planner once"):
        read_planners(["anytime", "anytime"])
    assert labels(["rrt_star", "rrt_star:range=0.4"]) == ["rrt_star", "rrt_star:range=0.4"]
    with pytest.raises(SettingError, match="at least one"):
        read_planners([])


def test_a_class_in_a_file_is_a_planner(tmp_path):
    file = planner_file(tmp_path)
    assert labels(None, [file]) == [*gp.PLANNERS, "straight"]
    assert labels(["anytime"], [file]) == ["anytime", "straight"]
    assert labels(["straight:pieces=4", "anytime"], [file]) == ["straight:pieces=4", "anytime"]
    (note,) = read_planners(["straight:pieces=4"], [file])
    assert note.make().pieces == 4
    assert note.to_document()["file"] == "straight.py"


def test_instances_in_a_file_count_by_their_variable(tmp_path):
    file = tmp_path / "variants.py"
    file.write_text("import graceful_plan as gp\nwide, narrow = gp.RRTStar(range=1.0), gp.RRTStar(range=0.1)\n")
    wide, narrow = read_planners([], [file])
    assert (wide.label, wide.make(), narrow.label) == ("wide", gp.RRTStar(range=1.0), "narrow")


def test_imported_classes_are_not_the_files_own(tmp_path):
    file = tmp_path / "empty.py"
    file.write_text("from graceful_plan import Planner, RRTStar\n")
    with pytest.raises(FormatError, match=r"empty.py: no planner in it; a planner file defines at least one"):
        read_planners(None, [file])


def test_a_class_without_solve_says_so(tmp_path):
    file = tmp_path / "half.py"
    file.write_text("from graceful_plan import Planner\n\n\nclass Half(Planner):\n    name = 'half'\n")
    with pytest.raises(FormatError, match="Half lacks solve"):
        read_planners(None, [file])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def broken(:\n", r"mine.py:1: raised SyntaxError"),
        ("x = 1\n\nraise ValueError('no luck')\n", r"mine.py:3: raised ValueError: no luck; a planner file defines"),
        ("import sys\nsys.exit(3)\n", r"mine.py:2: raised SystemExit: 3"),
        ("import no_such_module\n", r"mine.py:1: raised ModuleNotFoundError"),
        (
            "from graceful_plan import Planner\nclass Mine(Planner):\n    name = 'mine'\n"
            "    def __init__(self, x): pass\n    def solve(self, *args): pass\n",
            r"Mine\(\) raised TypeError",
        ),
    ],
)
def test_files_that_cannot_be_run_say_where(tmp_path, text, message):
    file = tmp_path / "mine.py"
    file.write_text(text)
    with pytest.raises(FormatError, match=message):
        read_planners(None, [file])


def test_a_file_that_is_not_there_and_one_that_is_not_python(tmp_path):
    with pytest.raises(FormatError, match="there is no such file"):
        read_planners(None, [tmp_path / "gone.py"])
    other = tmp_path / "planner.yaml"
    other.write_text("a: 1\n")
    with pytest.raises(FormatError, match="no Python file"):
        read_planners(None, [other])


def test_a_plain_class_will_do_but_has_no_settings(tmp_path):
    file = tmp_path / "plain.py"
    file.write_text(
        "from graceful_plan import Planner\n\n\nclass Plain(Planner):\n    name, anytime = 'plain', False\n"
        "    def solve(self, *args): pass\n"
    )
    assert labels(["plain"], [file]) == ["plain"]
    with pytest.raises(UnknownNameError, match="unknown setting of planner plain 'x'; valid: none"):
        read_planners(["plain:x=1"], [file])


def test_a_file_must_not_change_meanwhile(tmp_path):
    file = planner_file(tmp_path)
    (note,) = read_planners(["straight"], [file])
    assert note.make().pieces == 1
    file.write_text(file.read_text() + "\n# better\n")
    with pytest.raises(FormatError, match="changed since the comparison began"):
        note.make()


def test_two_planners_of_one_name_and_one_that_prints(tmp_path, capsys):
    file = planner_file(tmp_path)
    text = file.read_text()
    file.write_text(
        f"print('hello')\n{text}{text[text.index('@dataclass') :].replace('class Straight', 'class Other')}"
    )
    with pytest.raises(FormatError, match="two of its planners have one name: Straight, Other"):
        read_planners(None, [file])
    assert capsys.readouterr() == ("", "hello\n")


def test_names_of_planners_are_not_taken_twice(tmp_path):
    with pytest.raises(FormatError, match="'rrt_star' has the name of another one"):
        read_planners(None, [planner_file(tmp_path, name="rrt_star")])
