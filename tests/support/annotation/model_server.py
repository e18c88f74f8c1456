"""A local server with the OpenAI-compatible interface, for tests without a language model.

`guesses` answers by words in names, with the shipped rows of the guessed classes.
"""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Callable, Mapping, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any

from graceful_plan.scene.harm.fragility import FragilityTable
from graceful_plan.scene.harm.severity import SeverityTable

WORDS = {
    "adult_head": ("head", "face"),
    "child": ("infant", "child", "baby", "toddler"),
    "adult": ("person", "hand", "torso", "lap", "nurse", "worker", "man", "woman", "arm", "leg"),
    "pet": ("cat", "dog", "pet"),
    "laptop": ("laptop", "television", "monitor", "screen", "keyboard"),
    "phone": ("phone", "tablet"),
    "mains": ("socket", "strip", "lamp", "toaster", "kettle"),
    "glass": ("glass", "tumbler", "cup", "mug", "plate", "bowl", "bottle", "teapot", "jar", "vase"),
    "flame": ("candle", "stove", "flame", "hob"),
    "paper": ("book", "paper", "letter", "folder"),
    "textile": ("sofa", "bed", "carpet", "rug", "towel", "pillow"),
    "floor": ("floor", "stairs", "ramp"),
    "table": ("table", "counter", "desk", "shelf", "cabinet", "console", "sideboard"),
}
"""Words in names, by class; the first class with a match is used, else "robust"."""

Answer = tuple[int, Mapping[str, str], bytes]
"""Status, headers and body."""
Replies = Callable[[dict[str, Any]], Answer]


class ModelServer:
    """Serves on a free port while it is in a `with` statement.

    Args:
        replies: Function from the document of a request to the answer.
    """

    def __init__(self, replies: Replies) -> None:
        self.replies = replies
        self.asked: list[dict[str, Any]] = []
        """Documents of all requests."""
        self.headers: list[dict[str, str]] = []
        self.paths: list[str] = []
        handler = type("Handler", (_Handler,), {"owner": self})
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        self._server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/v1"
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)

    def __enter__(self) -> ModelServer:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Handler(BaseHTTPRequestHandler):
    owner: ModelServer

    def do_POST(self) -> None:  # noqa: N802, RUF100 - the name that the base class calls
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.owner.asked.append(json.loads(body))
        self.owner.headers.append(dict(self.headers))
        self.owner.paths.append(self.path)
        status, headers, answer = self.owner.replies(self.owner.asked[-1])
        with contextlib.suppress(OSError):  # the client may have stopped waiting
            self.send_response(status)
            for name, value in headers.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(answer)

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing."""


def said(text: str) -> Answer:
    """Return an answer of a model with this text."""
    document = {"choices": [{"index": 0, "message": {"role": "assistant", "content": text}, "finish_reason": "stop"}]}
    return 200, {"Content-Type": "application/json"}, json.dumps(document).encode()


def asked_about(document: Mapping[str, Any]) -> list[str]:
    """Return the entities in a request."""
    content = document["messages"][1]["content"]
    text = content if isinstance(content, str) else content[0]["text"]
    return list(json.loads(text)["entities asked about"])


def rows(names: Sequence[str]) -> dict[str, Any]:
    """Return guesses by words in names, in the form of an answer."""
    severity, fragility = SeverityTable.shipped(), FragilityTable.shipped()
    found = {}
    for name in names:
        category = next((c for c, words in WORDS.items() if any(word in name for word in words)), "robust")
        row = severity.rows[category]
        found[name] = {
            "class": category,
            "fragility": fragility.of(category).median,
            "significance": 1.0 if category in ("adult", "adult_head", "child") else 0.3,
            "severity": {component: row.get(component, 0.0) for component in severity.components},
            "reason": f"its name is {name}",
        }
    return found


def guesses(document: dict[str, Any]) -> Answer:
    """Answer with guesses by words in names."""
    return said(json.dumps({"entities": rows(asked_about(document))}))
