import math
import re
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser

import numpy as np
import pytest
from bench_cases import PROBLEMS, all_failed, comparison, rich, solved

from graceful_plan import compare as bench
from graceful_plan.compare.reports import figures
from graceful_plan.compare.reports.report import page
from graceful_plan.compare.reports.summary import gap, gap_curve, median, quantile, shares, solved_curve, time_grid
from graceful_plan.viz.html_page import number, percent
from sizes import first_quick

VOID = {"meta", "br", "link", "img", "hr", "input"}


class Balanced(HTMLParser):
    """Parses a page and records elements that are not closed, or closed twice."""

    def __init__(self):
        super().__init__(convert_charrefs=True)
        self.open, self.seen, self.ids, self.text, self.links = [], set(), [], [], []

    def handle_starttag(self, tag, attrs):
        self.seen.add(tag)
        given = dict(attrs)
        self.ids += [given["id"]] if "id" in given else []
        self.links += [given[key] for key in ("href", "src", "xlink:href") if key in given]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open and self.open[-1] == tag, f"</{tag}> closes {self.open[-3:]}"
        self.open.pop()

    def handle_data(self, data):
        self.text.append(data)


MANY = tuple(f"planner{i}" for i in range(11))
CASES = {
    "rich": rich(),
    "many planners": rich(MANY),
    "all failed": all_failed(),
    "no runs": comparison([], ("a", "b"), ("p",)),
    "one run": comparison([solved("p", "a", 0, 1.0)], ("a",), ("p",)),
    "a path that costs nothing": comparison([solved("p", "a", 0, 0.0)], ("a",), ("p",)),
    "begun": comparison(rich().runs[:5], ("first", "second <&>", "third"), PROBLEMS, seeds=2),
}


@cache
def written(case):
    return page(bench.summarise(CASES[case]))


def read(case):
    parser = Balanced()
    parser.feed(written(case))
    parser.close()
    assert parser.open == []
    return parser, " ".join(" ".join(parser.text).split())


@pytest.mark.parametrize("case", first_quick(CASES))
def test_pages_are_whole_and_need_nothing_else(case):
    compared = CASES[case]
    parser, text = read(case)
    for name in (*compared.planners, *compared.problems):
        assert name in text or not compared.runs
    assert "abacus" in text
    assert "nan" not in text.lower().replace("dominant", "")
    assert len(parser.ids) == len(set(parser.ids))
    assert all(link.startswith("#") for link in parser.links)
    assert not parser.seen & {"script", "img", "link", "iframe"}


def test_references_inside_of_figures_lead_somewhere():
    text = written("rich")
    assert set(re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', text)) != set()
    used = {a or b for a, b in re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', text)}
    assert used <= set(re.findall(r' id="([^"]+)"', text))


def test_a_page_is_the_same_every_time():
    assert page(bench.summarise(rich())) == written("rich")


@pytest.mark.long
def test_the_page_has_the_expected_numbers():
    _, text = read("rich")
    assert "7 problems, 3 planners, 2 seeds" in text
    assert "28 runs" not in text
    assert "Runs without a verified result" in text and "<broken & bad>" in text
    assert "RAISED" in text and "TIMEOUT" in text
    _, begun = read("begun")
    assert "5 of 42" in begun
    _, failed = read("all failed")
    assert ": a, b." in failed
    assert "2 problems" in failed
    _, empty = read("no runs")
    assert "No run is done yet." in empty


def test_calls_that_return_late_are_named():
    runs = [replace(solved("p", "slow", seed, 1.0), seconds=0.6 + 0.2 * seed) for seed in range(2)]
    summary = bench.summarise(comparison([*runs, solved("p", "quick", 0, 1.0)], ("slow", "quick"), ("p",), seeds=2))
    assert [planner.late for planner in summary.planners] == [1, 0]
    assert "slow 1 of 2" in page(summary)


def test_figures_have_every_planner():
    summary = bench.summarise(rich())
    for figure in (figures.solved_figure, figures.gap_figure, figures.share_figure, figures.spread_figure):
        svg = figure(summary)
        assert svg.startswith("<svg") and svg.endswith("</svg>")
        assert all(name in svg for name in ("first", "second &lt;&amp;&gt;", "third"))


# --- summary ---------------------------------------------------------------------------------------------------------


def test_gaps_and_medians_by_hand():
    summary = bench.summarise(rich())
    first, second, third = summary.planners
    assert list(summary.best.values()) == pytest.approx([1.0 + i for i in range(7)])
    assert (first.gap, second.gap) == pytest.approx((0.001, 0.1011))  # of 7 times 0 and 7 times 0.001: the worse one
    assert third.gap == math.inf  # half of its runs failed
    assert (first.solved, third.solved, third.runs) == (14, 7, 14)
    assert dict(third.outcomes) == {"SOLVED": 7, "TIMEOUT": 3, "RAISED": 4}
    assert (first.first, second.first, third.first) == (0.001, 0.002, math.inf)
    # Twice the cost until ten times the time to the first path.
    assert first.gap_at["0.01"] == pytest.approx(0.001)
    assert second.gap_at["0.01"] == pytest.approx(2 * 1.1 * 1.001 - 1.0)
    assert (first.motion, first.impact) == pytest.approx((0.75, 0.25), rel=2e-3)
    assert [(p.first, p.second, p.wins, p.losses) for p in summary.pairs[:2]] == [
        ("first", "second <&>", 0, 7),
        ("first", "third", 0, 7),
    ]


def test_curves():
    compared = rich()
    best = bench.summarise(compared).best
    times = np.array([0.0005, 0.0015, 0.005, 0.02, 0.05])
    lower, middle, upper = gap_curve(compared, "first", best, times)
    assert middle[0] == math.inf
    assert middle[1:] == pytest.approx([1.002, 1.002, 0.001, 0.001])
    assert np.all((lower <= middle) & (middle <= upper))
    assert solved_curve(compared, "third", np.array([0.001, 0.1])).tolist() == [0.0, 0.5]
    grid = time_grid(compared)
    assert (grid[0], grid[-1]) == pytest.approx((0.001, 0.5))


def test_best_costs_from_other_files_count():
    compared = rich()
    known = type(compared)(**{**vars(compared), "known": {PROBLEMS[0]: 0.5}})
    assert bench.summarise(known).best[PROBLEMS[0]] == 0.5
    (first, *_) = shares(known, bench.summarise(known).best, "first")
    assert first == pytest.approx([1.5, 0.5], rel=2e-3)


@pytest.mark.parametrize(
    ("total", "best", "expected"),
    [(1.1, 1.0, 0.1), (math.inf, 1.0, math.inf), (1.0, math.inf, math.inf), (0.0, 0.0, 0.0), (0.5, 0.0, 0.5)],
)
def test_gap(total, best, expected):
    assert gap(total, best) == pytest.approx(expected)


def test_medians_are_pessimistic():
    assert median([1.0, math.inf]) == math.inf
    assert median([1.0, 2.0, math.inf]) == 2.0
    assert math.isnan(median([]))
    assert quantile(np.array([[4.0, 1.0, 3.0, 2.0, 5.0]]), 0.25).tolist() == [2.0]


def test_words_for_numbers():
    assert [number(x) for x in (math.nan, math.inf, 0.01234, 123.4, 12345.6)] == ["–", "∞", "0.0123", "123", "12346"]
    assert [percent(x) for x in (math.nan, math.inf, 0.0123, 12.34)] == ["–", "∞", "1.2 %", "1234 %"]


def test_the_document_is_plain():
    document = bench.summarise(rich()).to_document()
    assert [planner["planner"] for planner in document["planners"]] == ["first", "second <&>", "third"]
    assert (document["runs"], document["expected"], len(document["pairs"])) == (42, 42, 3)


@pytest.mark.parametrize(("problems", "told"), [(20, "not luck"), (3, "which may be luck")])
def test_the_headline_says_who_is_best_and_whether_it_is_luck(problems, told):
    names = tuple(f"p{k}" for k in range(problems))
    runs = [solved(name, planner, 0, cost) for name in names for planner, cost in (("a", 2.0), ("b", 1.0))]
    text = page(bench.summarise(comparison(runs, ("a", "b"), names)))
    assert f"Least cost: b, better than a on {problems} of {problems} problems and worse on 0, {told}" in text
    assert "Most problems solved: all planners" in text and "First path the soonest" in text
    assert "Least cost" not in written("no runs") + written("one run") + written("all failed")
