"""Completions of shells, from the shells themselves, where installed."""

import re
import shutil
import subprocess

import pytest

import graceful_plan as gp
from graceful_plan.tools import cli
from graceful_plan.tools.completion.scripts import SHELLS


@pytest.fixture
def script(run):
    def script(shell: str) -> str:
        code, out, err = run("completion", shell)
        assert (code, err) == (cli.DONE, "")
        return out

    return script


@pytest.fixture
def offered(script, tmp_path):
    """Return bash's completions of the last word."""

    def offered(*words: str) -> list[str]:
        line = " ".join(f"'{word}'" for word in ("graceful-plan", *words))
        ask = f"{script('bash')}\nCOMP_WORDS=({line}); COMP_CWORD={len(words)}; _graceful_plan\n"
        done = subprocess.run(
            ["bash", "-c", ask + 'printf "%s\\n" "${COMPREPLY[@]}"'],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            check=False,
        )
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout.split()

    return offered


def test_bash_offers_commands(offered):
    assert offered("pl") == ["plan", "planners"]
    assert set(cli.parser().commands) <= set(offered(""))


def test_bash_offers_options_of_the_command(offered):
    assert offered("plan", "--va") == ["--validate"]
    assert "--height" in offered("map", "--") and "--height" not in offered("plan", "--")


def test_bash_offers_values(offered, tmp_path):
    (tmp_path / "mine.yaml").touch()
    assert offered("plan", "--scene", "des") == ["desk"]
    assert offered("plan", "--scene", "mi") == ["mine.yaml"]
    assert offered("evaluate", "mi") == ["mine.yaml"]
    assert offered("bench", "--planners", "auto", "rrt_c") == ["rrt_connect"]
    assert offered("plan", "--planner", "m") == []
    assert offered("completion", "f") == ["fish"]
    assert offered("plan", "--w", "") == []


@pytest.mark.parametrize("shell", SHELLS)
def test_scripts_know_every_command_option_and_scene(script, shell):
    text = script(shell)
    for name, command in cli.parser().commands.items():
        assert name in text
        for argument in command.arguments:
            assert all(option.lstrip("-") in text for option in argument.option_strings)
    assert all(name in text for name in (*gp.scenes(), *gp.PLANNERS))


@pytest.mark.skipif(shutil.which("zsh") is None, reason="zsh is not installed")
def test_zsh_understands_its_script(script, tmp_path):
    (tmp_path / "script").write_text(script("zsh"))
    ask = f"autoload -U compinit; compinit -D; source {tmp_path / 'script'}; print $_comps[graceful-plan]"
    done = subprocess.run(["zsh", "-fc", ask], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("_graceful_plan\n", "")


@pytest.mark.skipif(shutil.which("zsh") is None, reason="zsh is not installed")
@pytest.mark.parametrize(
    ("typed", "completed"),
    [("plan --scene des", "desk "), ("plan --scene mi", "mine.yaml "), ("evaluate mi", "mine.yaml "), ("pla", "plan")],
)
def test_zsh_completes_as_one_types(script, tmp_path, typed, completed):
    """A zsh in its own terminal; the test waits for the words."""
    (tmp_path / "script").write_text(script("zsh"))
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "mine.yaml").touch()
    begin = f"PS1=; autoload -U compinit; compinit -D -u; source {tmp_path / 'script'}; bindkey '^I' complete-word"
    ask = (
        f'zmodload zsh/zpty; zpty w zsh -f -i; zpty -w w "{begin}; print rea""dy"; zpty -r w out "*ready*"\n'
        f"zpty -n -w w $'graceful-plan {typed}\\t'; zpty -r w out '*{completed.replace(' ', '?')}*'; print $out"
    )
    done = subprocess.run(
        ["zsh", "-fc", ask], capture_output=True, text=True, check=False, cwd=tmp_path / "here", timeout=60
    )
    assert done.returncode == 0
    assert not re.search(r"\(eval\)|command not found|bad option", done.stdout)


@pytest.mark.skipif(shutil.which("fish") is None, reason="fish is not installed")
def test_fish_offers_commands_and_values(script, tmp_path):
    (tmp_path / "script").write_text(script("fish"))

    def offered(line: str) -> set[str]:
        ask = f"source {tmp_path / 'script'}; complete -C '{line}'"
        done = subprocess.run(["fish", "--no-config", "-c", ask], capture_output=True, text=True, check=True)
        return {row.split("\t")[0] for row in done.stdout.splitlines()}

    assert offered("graceful-plan pl") == {"plan", "planners"}
    assert "desk" in offered("graceful-plan plan --scene des")
    assert offered("graceful-plan plan --vali") == {"--validate"}


def test_other_shells_are_misuse(run):
    code, out, err = run("completion", "tcsh")
    assert (code, out) == (cli.MISUSE, "")
    assert "invalid choice: 'tcsh'" in err
