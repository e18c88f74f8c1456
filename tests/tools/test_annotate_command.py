"""The command `annotate`, against a server on this machine."""

import json

import pytest

from graceful_plan.annotation.annotations import Annotations
from graceful_plan.tools import cli
from support.annotation.model_server import ModelServer, guesses, said


@pytest.fixture
def server():
    with ModelServer(guesses) as running:
        yield running


def asked(server, file, *more):
    words = ("--endpoint", server.url, "--model", "stub", "--no-pictures", "--output", str(file))
    return ("annotate", "--scene", "tabletop_l1", *words, *more)


def test_annotations_are_written_and_reported(run, server, tmp_path):
    code, out, err = run(*asked(server, tmp_path / "s.yaml"))
    assert (code, err) == (cli.DONE, "")
    assert "table: table. " in out and "rank correlation" in out
    assert list(Annotations.load(tmp_path / "s.yaml").rows)[:2] == ["white1", "white2"]


def test_json_is_one_document(run, server, tmp_path):
    code, out, _ = run(*asked(server, tmp_path / "s.yaml", "--json"))
    document = json.loads(out)
    assert code == cli.DONE and document["agreement"]["entities"] == len(document["annotations"]["entities"])


def test_a_dry_run_sends_nothing(run, server):
    code, out, _ = run("annotate", "--scene", "tabletop_l1", "--dry-run", "--endpoint", server.url)
    assert (code, server.asked) == (cli.DONE, [])
    assert "white1" in out and out.startswith("system:")


def test_a_useless_answer_is_a_failure_and_leaves_no_file(run, server, tmp_path):
    server.replies = lambda document: said("no")
    code, out, err = run(*asked(server, tmp_path / "s.yaml", "--json"))
    assert (code, json.loads(out)["error"]) == (cli.FAILED, "AnnotationError")
    assert "it has no JSON object" in err and not (tmp_path / "s.yaml").exists()
    server.replies = lambda document: (500, {}, b"")
    code, _, err = run(*asked(server, tmp_path / "s.yaml"))
    assert (code, "HTTP 500" in err, err.count("\n")) == (cli.FAILED, True, 1)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "--endpoint = None"),
        (("--endpoint", "http://localhost/v1"), "--model = None"),
        (("--endpoint", "http://localhost/v1", "--model", "m"), "--output = None"),
        (("--endpoint", "http://localhost/v1", "--model", "m", "--output", "s.json"), "ends in .yaml or .yml"),
        (("--endpoint", "file:///etc", "--model", "m", "--output", "s.yaml"), "a base URL such as"),
    ],
)
def test_misuse_is_reported_before_any_request(run, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    code, _, err = run("annotate", "--scene", "tabletop_l1", *words)
    assert (code, message in err) == (cli.MISUSE, True)
