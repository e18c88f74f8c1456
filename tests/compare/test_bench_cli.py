import dataclasses
import inspect
import json
import re
import sys

import pytest
from bench_cases import own_planner, suite_file

import graceful_plan as gp
from graceful_plan import compare as bench
from graceful_plan.compare.reports import figures
from graceful_plan.tools import cli


@pytest.fixture(autouse=True)
def blank_figures(monkeypatch):
    """Skip figures: they are tested with the report, and drawing dominates the time."""
    monkeypatch.setattr(figures, "svg", lambda draw, name, height: "<svg></svg>")


@pytest.fixture
def run(capsys, tmp_path):
    """Run the command on planar problems in this process; return exit code, standard output and error."""

    def run(*argv: str, suite: str = "free_space, uniform_density") -> tuple[int, str, str]:
        source = str(suite_file(tmp_path, suite)) if "--suite" not in argv else argv[argv.index("--suite") + 1]
        given = [*argv, "--suite", source, "--processes", "0"]
        given += [] if "--out" in argv else ["--out", str(tmp_path / "out")]
        code = cli.main(["bench", *given])
        return code, *capsys.readouterr()

    return run


@pytest.mark.long
def test_the_command_leaves_everything_in_its_folder(run, tmp_path):
    code, out, err = run("--planners", "rrt_connect", "anytime", "--export", "csv,parquet,arena")
    assert code == cli.DONE
    assert re.search(r"^rrt_connect +4/4 .*reference", out, flags=re.MULTILINE)
    assert re.search(r"^anytime +4/4 .*\d/\d/\d", out, flags=re.MULTILINE)
    assert err == ""
    written = {file.name for file in (tmp_path / "out").iterdir()}
    tables = {f"{name}.{ending}" for name in ("runs", "trace") for ending in ("csv", "parquet")}
    assert written == {"journal.jsonl", "report.html", "best_known.yaml", "planner_arena.db", *tables}


@pytest.mark.long
def test_json_is_one_document(run):
    code, out, _ = run("--planners", "rrt_connect", "--seeds", "7,", "--json")
    document = json.loads(out)
    assert code == cli.DONE
    assert (document["schema"], document["seeds"], document["runs"]) == ("graceful_plan.bench.summary", [7], 2)
    assert document["planners"][0]["planner"] == "rrt_connect"


def test_runs_are_counted_on_a_terminal(run, monkeypatch):
    monkeypatch.setattr(sys.stderr.__class__, "isatty", lambda self: True)
    _, _, err = run("--planners", "rrt_connect", "--seeds", "1")
    assert "\r\x1b[K2/2 runs: analytic/uniform_density, rrt_connect, SOLVED" in err
    assert err.endswith("\r\x1b[K")
    assert run("--planners", "rrt_connect", "--seeds", "1", "--json")[2] == ""


def test_the_same_command_resumes_and_another_one_is_refused(run):
    argv = ("--planners", "rrt_connect", "--seeds", "1")
    first, again = run(*argv, "--json"), run(*argv, "--json")
    assert json.loads(first[1])["planners"] == json.loads(again[1])["planners"]
    code, _, err = run(*argv, "--w", "2")
    assert code == cli.MISUSE
    assert re.search(r"w .*1\.0.*2\.0", err)


def test_a_report_of_existing_runs(run, tmp_path):
    run("--planners", "rrt_connect", "--seeds", "1")
    (tmp_path / "out" / "report.html").unlink()
    code, out, _ = run("--report-only", "--export", "csv")
    assert code == cli.DONE
    assert "rrt_connect  2/2" in out
    assert (tmp_path / "out" / "report.html").exists() and (tmp_path / "out" / "runs.csv").exists()


def test_best_costs_of_another_comparison(run, tmp_path):
    known = tmp_path / "known.yaml"
    known.write_text("version: 1\nw: 1\nbest_known: {analytic/free_space: 1.0}\n")
    code, out, _ = run("--planners", "rrt_connect", "--seeds", "1", "--known", str(known), "--json")
    assert code == cli.DONE
    assert json.loads(out)["best_known"]["analytic/free_space"] == 1.0
    code, _, err = run("--planners", "rrt_connect", "--seeds", "1", "--known", str(known), "--w", "3")
    assert code == cli.MISUSE
    assert "known.yaml" in err


@pytest.mark.long
def test_a_custom_planner(run, here):
    own = own_planner(here)
    code, out, _ = run("--planners", "rrt_connect", "--planner", f"{own}:pieces=2", "--seeds", "1")
    assert code == cli.DONE
    assert re.search(r"^rrt_connect +2/2 .*reference", out, flags=re.MULTILINE)
    assert re.search(r"^straight:Straight:pieces=2 +2/2", out, flags=re.MULTILINE)


def test_without_a_list_a_custom_planner_is_compared_with_all_others(here, monkeypatch):
    asked = {}
    monkeypatch.setattr(bench, "compare", lambda suite, **given: asked.update(given))
    monkeypatch.setattr(bench, "summarise", lambda comparison: pytest.fail("far enough"))
    with pytest.raises(pytest.fail.Exception, match="far enough"):
        cli.main(["bench", "--planner", own_planner(here)])
    assert asked["planners"] == [*gp.PLANNERS, "straight:Straight"]


def test_nothing_solved_has_its_own_exit_code(run, here):
    broken = own_planner(here, "raise ValueError('oops')", "broken")
    code, out, _ = run("--planners", broken, "--seeds", "1")
    assert code == cli.FAILED
    assert "0/2" in out
    assert "ValueError: oops" in (here / "out" / "report.html").read_text()


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (("--suite", "kitchens"), "unknown suite 'kitchens'"),
        (("--planners", "hope"), "unknown planner 'hope'"),
        (("--planners", "rrt_star:hope=1"), "unknown setting of planner rrt_star 'hope'"),
        (("--seeds", "many"), "--seeds = 'many'"),
        (("--seeds", "0"), "seeds = 0"),
        (("--seconds", "-1"), "seconds = -1.0"),
        (("--export", "excel"), "unknown export 'excel'; valid: arena, csv, parquet"),
        (("--planner", "nowhere:Mine"), "there is no module 'nowhere'"),
        (("--known", "nowhere.yaml"), "cannot be read"),
        (("--report-only",), "cannot be read: No such file"),
    ],
)
def test_misuse_ends_early_and_in_one_line(run, tmp_path, argv, message):
    code, out, err = run(*argv)
    assert (code, out) == (cli.MISUSE, "")
    assert message in err and err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_problem_files_are_suites(run, tmp_path):
    file = tmp_path / "set.yaml"
    file.write_text(
        """
easy:
  - start: [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]
    goal_ik: [[0.5, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]]
    obstacles: {}
"""
    )
    (problem,) = bench.load_suite(file).problems
    assert (problem.kind, problem.name.split("/")[0]) == ("file", "easy")
    argv = ("--suite", str(file), "--planners", "rrt_connect", "--seconds", "1.0", "--seeds", "1", "--json")
    code, out, _ = run(*argv)
    assert code == cli.DONE
    document = json.loads(out)
    assert document["w"] == 0.0
    assert document["best_known"][problem.name] == pytest.approx(0.5, abs=1e-3)
    assert "<h2>Motion and impact</h2>" not in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize("cls", [bench.Run, bench.Comparison, bench.PlannerSummary])
def test_field_tables_list_the_fields(cls):
    rows = re.findall(r"^\s*\| (\w+) ", inspect.getdoc(cls) or "", flags=re.MULTILINE)
    assert rows == ["field", *(field.name for field in dataclasses.fields(cls))]


def test_the_version_is_in_the_settings(run, tmp_path):
    run("--planners", "rrt_connect", "--seeds", "1")
    assert f"graceful_plan {gp.__version__}" in bench.load_comparison(tmp_path / "out").settings["versions"]
