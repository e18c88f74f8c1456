"""The worker thread answers only the latest request."""

from __future__ import annotations

import threading

import pytest

from graceful_plan.viewer.worker import LatestRequestWorker

_LONG = 20.0
"""Seconds after which a test fails."""


class Work:
    """Answers when allowed, and records cancelled requests."""

    def __init__(self):
        self.began, self.go = threading.Semaphore(0), threading.Event()
        self.cancelled = []

    def __call__(self, question, cancelled):
        self.began.release()
        while not self.go.wait(0.001):
            if cancelled():
                self.cancelled.append(question)
                break
        if question == "broken":
            raise ValueError("broken")
        return f"answer to {question}"


@pytest.fixture
def desk():
    work, answers, errors = Work(), [], []
    worker = LatestRequestWorker(work, answers.append, errors.append)
    yield worker, work, answers, errors
    worker.close()


def test_the_latest_question_is_answered_and_older_ones_are_cancelled(desk):
    worker, work, answers, errors = desk
    worker.ask("first")
    assert work.began.acquire(timeout=_LONG) and not worker.idle
    for question in ("second", "third", "last"):
        worker.ask(question)
    work.go.set()
    assert worker.wait(_LONG)
    assert answers == ["answer to last"] and errors == []
    assert set(work.cancelled) <= {"first", "second", "third"}


def test_errors_are_reported_and_the_worker_continues(desk):
    worker, work, answers, errors = desk
    work.go.set()
    worker.ask("broken")
    assert worker.wait(_LONG)
    worker.ask("whole")
    assert worker.wait(_LONG)
    assert [str(error) for error in errors] == ["broken"] and answers == ["answer to whole"]


def test_a_closed_worker_takes_no_questions(desk):
    worker, work, answers, _ = desk
    work.go.set()
    worker.ask("first")
    assert worker.wait(_LONG)
    worker.close()
    worker.ask("second")
    assert answers == ["answer to first"] and worker.idle
