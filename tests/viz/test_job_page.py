"""The page of a job: all steps, entities and rejected alternatives, of any name, in one file."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from order_jobs import job_scene, ordered

import failbench as fb
import graceful_plan as gp
from failbench.basics.statistics import Estimate
from graceful_plan.exceptions import SettingError
from graceful_plan.job.job_result import JobResult
from graceful_plan.viz.job_page import write_job_page

NASTY = "<img src=x onerror=alert(1)>"
VOID = {"meta", "br", "wbr", "use", "path", "image"}


class Reader(HTMLParser):
    """Collects rows of tables, elements and text, and checks that elements are closed."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.tags: list[str] = []
        self.text = ""
        self._open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.rows += [[]] if tag == "tr" else []
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data
        if {"td", "th"} & set(self._open):
            self.rows[-1][-1] += data


def read(result: JobResult, folder: Path, **options: object) -> Reader:
    file = folder / "job.html"
    write_job_page(result, file, **options)  # type: ignore[arg-type]
    text = file.read_text(encoding="utf-8")
    assert not re.search(r"(src|href)=.?https?:", text)
    reader = Reader()
    reader.feed(text)
    return reader


def validation(result: JobResult) -> fb.JobValidation:
    parts = tuple(Estimate(1e-6 * (k + 1), 0.0, 2e-5, 10) for k in range(len(result.steps)))
    return fb.JobValidation(
        observed=Estimate(1e-5, 0.0, 8e-5, 40),
        by_step=parts,
        steps=tuple(step.name for step in result.steps),
        starts=tuple(0.0 for _ in result.steps),
        motions=(),
        duration=result.duration,
    )


def test_the_page_has_all_steps_entities_and_alternatives(tmp_path: Path) -> None:
    result = ordered(3.0)
    page = read(result, tmp_path)
    firsts = [row[0] for row in page.rows if row]
    for step in result.steps:
        assert firsts.count(f"{step.kind} {step.name}") == 1
        assert page.text.count(f"{step.kind} {step.name}") >= 2  # in the figure, too
    harmed = [name for name, value in result.cost.impact_by_entity.items() if value > 0.0]
    assert harmed and set(harmed) <= set(firsts)
    assert result.rejected and all(one.name in firsts for one in result.rejected)
    assert "svg" in page.tags


def test_observed_harm_is_shown_by_step(tmp_path: Path) -> None:
    result = ordered(3.0)
    page = read(result, tmp_path, observed=validation(result).to_document())
    (last,) = (row for row in page.rows if row and row[0] == f"{result.steps[3].kind} {result.steps[3].name}")
    assert "4" in last and "0 to 20" in last
    with pytest.raises(SettingError, match="steps"):
        write_job_page(ordered(3.0), tmp_path / "job.html", observed={"by_step": []})


def test_names_are_text_and_no_markup(tmp_path: Path) -> None:
    result = ordered(3.0)
    cost = replace(result.cost, impact_by_entity={NASTY: result.cost.impact})
    steps = tuple(replace(step, name=NASTY, cost=cost) for step in result.steps)
    (one, *_) = result.rejected
    rejected = replace(one, actions=(("place", NASTY),), cost=cost)
    page = read(replace(result, steps=steps, cost=cost, rejected=(rejected,)), tmp_path, title=NASTY)
    assert "img" not in page.tags and "script" not in page.tags
    assert page.text.count(NASTY) > len(steps)


def test_a_job_without_harm_has_a_page(tmp_path: Path) -> None:
    result = ordered(3.0)
    none = replace(result.cost, impact=0.0, impact_by_entity={})
    steps = tuple(
        replace(step, cost=none, pieces=tuple(replace(piece, cost=none) for piece in step.pieces))
        for step in result.steps
    )
    page = read(replace(result, steps=steps, cost=none, rejected=()), tmp_path)
    assert all(any(row[0] == f"{step.kind} {step.name}" for row in page.rows) for step in steps)


def test_the_page_of_an_impossible_job_says_why(tmp_path: Path) -> None:
    far = gp.Job(job_scene("order")).place("crate", at=[1.5, 0.0, 0.4])
    result = gp.plan_job(far, iterations=2)
    page = read(result, tmp_path)
    assert result.detail in page.text and "svg" not in page.tags
