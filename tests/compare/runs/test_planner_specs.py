import pytest
from bench_cases import own_planner

import graceful_plan as gp
from graceful_plan.compare.runs.planner_specs import PlannerImportError, read_planners
from graceful_plan.exceptions import FormatError, SettingError, UnknownNameError


def labels(words):
    return [note.label for note in read_planners(words)]


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
        ("hope:x=1", UnknownNameError, "unknown planner 'hope'"),
        ("hope:", UnknownNameError, "unknown planner 'hope'"),
        ("rrt_star:range", SettingError, "name:setting=value"),
        ("rrt_star:", SettingError, "name:setting=value"),
        ("rrt_star:range=-1.0", SettingError, "range = -1.0"),
        ("rrt_star:range=wide", SettingError, "range = 'wide'"),
        ("rrt_star:range=[1]", SettingError, "a number, a word, true, false or null"),
        ("rrt_star:range=1,range=2", SettingError, "every setting once"),
    ],
)
def test_broken_planners_are_refused_early(word, error, message):
    with pytest.raises(error, match=message):
        read_planners([word])


def test_planners_are_compared_once():
    with pytest.raises(SettingError, match="every planner once"):
        read_planners(["anytime", "anytime"])
    assert labels(["rrt_star", "rrt_star:range=0.4"]) == ["rrt_star", "rrt_star:range=0.4"]
    with pytest.raises(SettingError, match="at least one"):
        read_planners([])


def test_a_class_is_imported_by_its_name_from_the_current_directory(here):
    word = own_planner(here)
    assert word == "straight:Straight"
    assert labels(["anytime", word]) == ["anytime", word]
    (note,) = read_planners([f"{word}:pieces=4"])
    assert note.make().pieces == 4
    document = note.to_document()
    assert (document["label"], document["name"], document["settings"]) == (f"{word}:pieces=4", word, {"pieces": 4})
    assert str(here) not in str(document)


def test_a_class_of_a_package_is_imported_too(here):
    (here / "mine").mkdir()
    (here / "mine" / "__init__.py").touch()
    own_planner(here / "mine")
    (note,) = read_planners(["mine.straight:Straight"])
    assert note.make().name == "straight"


def test_an_imported_class_will_do():
    (note,) = read_planners(["graceful_plan:RRTStar:range=0.4"])
    assert note.make() == gp.RRTStar(range=0.4)


NOT_DERIVED = "class Mine:\n    name = 'mine'\n"
HALF = "from graceful_plan import Planner\n\n\nclass Mine(Planner):\n    name = 'mine'\n"
DEMANDING = (
    "from graceful_plan import Planner\nclass Mine(Planner):\n    name, anytime = 'mine', False\n"
    "    def __init__(self, x): pass\n    def solve(self, *args): pass\n"
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (NOT_DERIVED, "planner mine:Mine: is no class derived from graceful_plan.Planner"),
        ("from graceful_plan import RRTStar\nMine = RRTStar()\n", "is no class derived from graceful_plan.Planner"),
        (HALF, "planner mine:Mine: lacks solve"),
        (DEMANDING, "has to be made without arguments; that raised TypeError: .*'x'"),
        ("def broken(:\n", r"importing mine raised SyntaxError: .*\(mine.py:1\)"),
        ("x = 1\n\nraise ValueError('no luck')\n", r"importing mine raised ValueError: no luck \(mine.py:3\)"),
        ("import sys\nsys.exit(3)\n", r"importing mine raised SystemExit: 3 \(mine.py:2\)"),
        ("import no_such_module\n", r"importing mine raised ModuleNotFoundError: .*no_such_module.* \(mine.py:1\)"),
    ],
)
def test_errors_name_the_fault_of_a_class(here, text, message):
    (here / "mine.py").write_text(text)
    with pytest.raises(PlannerImportError, match=message) as caught:
        read_planners(["mine:Mine"])
    assert caught.value.planner == "mine:Mine"


def test_missing_modules_and_classes_are_named(here):
    with pytest.raises(PlannerImportError, match="'no_such_place'"):
        read_planners(["no_such_place.planners:Mine"])
    own_planner(here)
    with pytest.raises(PlannerImportError, match=r"'straight\.deeper'"):
        read_planners(["straight.deeper:Mine"])
    with pytest.raises(UnknownNameError, match=r"straight 'Bent'.*Straight"):
        read_planners(["straight:Bent"])


def test_a_plain_class_will_do_but_has_no_settings(here):
    (here / "plain.py").write_text(
        "from graceful_plan import Planner\n\n\nclass Plain(Planner):\n    name, anytime = 'plain', False\n"
        "    def solve(self, *args): pass\n"
    )
    assert labels(["plain:Plain"]) == ["plain:Plain"]
    with pytest.raises(UnknownNameError, match="plain:Plain 'x'"):
        read_planners(["plain:Plain:x=1"])


def test_a_module_must_not_change_meanwhile(here):
    (note,) = read_planners([own_planner(here)])
    assert note.make().pieces == 1
    file = here / "straight.py"
    file.write_text(file.read_text() + "\n# better\n")
    with pytest.raises(FormatError, match="straight: changed"):
        note.make()


def test_output_of_an_imported_module_stays_out_of_the_command(here, capsys):
    word = own_planner(here)
    file = here / "straight.py"
    file.write_text(f"print('hello')\n{file.read_text()}")
    read_planners([word])
    assert capsys.readouterr() == ("", "hello\n")


def test_no_file_of_the_current_directory_hides_an_installed_module(here):
    (here / "mujoco.py").write_text("raise ValueError('hidden')\n")
    with pytest.raises(UnknownNameError, match=r"mujoco\.batch 'Mine'"):
        read_planners(["mujoco.batch:Mine"])
