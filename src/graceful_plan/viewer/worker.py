"""Worker thread for the latest request: older ones are cancelled and their answers dropped."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Q = TypeVar("Q")
A = TypeVar("A")


class LatestRequestWorker(Generic[Q, A]):
    """Worker that processes one request at a time.

    Args:
        work: Answers a request; its second argument is a function that returns whether it is cancelled.
        done: Called with an answer that is still current, in the worker's thread.
        failed: Called with an exception of `work` or `done`, in the same thread.
    """

    def __init__(
        self,
        work: Callable[[Q, Callable[[], bool]], A],
        done: Callable[[A], None],
        failed: Callable[[Exception], None],
    ) -> None:
        self._work, self._done, self._failed = work, done, failed
        self._changed = threading.Condition()
        self._waiting: list[Q] = []
        self._cancel = threading.Event()
        self._busy = self._closed = False
        self._thread = threading.Thread(target=self._run, name="viewer-planner", daemon=True)

    def ask(self, question: Q) -> None:
        """Submit a request and cancel the current one."""
        with self._changed:
            if self._closed:
                return
            self._waiting[:] = [question]
            self._cancel.set()
            if not self._thread.is_alive():
                self._thread.start()
            self._changed.notify_all()

    @property
    def idle(self) -> bool:
        """Whether no request is waiting or in progress."""
        with self._changed:
            return not self._waiting and not self._busy

    def wait(self, timeout: float | None = None) -> bool:
        """Wait at most a time [s] until the worker is idle; return whether it is."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._waiting and not self._busy, timeout)

    def close(self) -> None:
        """Cancel the current request and end the thread."""
        with self._changed:
            self._closed = True
            self._waiting.clear()
            self._cancel.set()
            self._changed.notify_all()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(timeout=10.0)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: bool(self._waiting) or self._closed)
                if self._closed:
                    return
                question, cancel = self._waiting.pop(), threading.Event()
                self._cancel, self._busy = cancel, True
            try:
                answer = self._work(question, cancel.is_set)
                if not cancel.is_set():
                    self._done(answer)
            except Exception as error:  # no caller above this thread: report to the requester
                if not cancel.is_set():
                    self._failed(error)
