"""Client of a language model with an OpenAI-compatible endpoint, bounded in time and size.

Only HTTP and HTTPS are supported, and redirections are not followed, so a key reaches only the named server. The key is
read from an environment variable at each request; no object, message or file contains it.
"""

from __future__ import annotations

import io
import json
import os
import re
import socket
import ssl
import time
import urllib.error
import urllib.request
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from http.client import HTTPConnection, HTTPException, HTTPResponse, HTTPSConnection
from typing import Any, final
from urllib.parse import SplitResult, urlsplit, urlunsplit

from graceful_plan._version import __version__
from graceful_plan.exceptions import EndpointError, SettingError
from graceful_plan.path import is_real, plain_numbers

MAX_ANSWER = 2_000_000
"""Maximum size of an answer [bytes]."""
_SHOWN = 300
"""Number of characters of a server's response that an error message quotes."""
_LOCAL = ("localhost", "127.0.0.1", "::1")
_HIDDEN = "***"


@final
@dataclass(frozen=True, kw_only=True)
class Endpoint:
    """Endpoint and name of a model.

    Args:
        url: Base URL; "/chat/completions" is added to its path.
        model: Name of the model.
        key_variable: Environment variable with the API key; None if the server needs no key.
        timeout: Time limit for an answer [s].

    Raises:
        SettingError: If the URL is not HTTP or HTTPS or contains a password, a key would be sent over plain HTTP to
            another machine, or another setting is invalid.
    """

    url: str
    model: str
    key_variable: str | None = None
    timeout: float = 60.0

    def __post_init__(self) -> None:
        plain_numbers(self)
        parts = _split(self.url)
        if not isinstance(self.model, str) or not self.model.strip():
            raise SettingError("model", self.model, "the name of a model")
        if not is_real(self.timeout) or not 0 < self.timeout < 1e6:
            raise SettingError("timeout", self.timeout, "seconds above 0, below a million")
        if self.key_variable is not None:
            if not isinstance(self.key_variable, str) or not self.key_variable.isidentifier():
                raise SettingError("key_variable", _HIDDEN, "the name of an environment variable, not a key itself")
            if parts.scheme == "http" and parts.hostname not in _LOCAL:
                raise SettingError("endpoint", self.name, "https, where a key is sent to another machine")

    @property
    def name(self) -> str:
        """URL without the query, for display."""
        parts = _split(self.url)
        return urlunsplit((parts.scheme, parts.netloc, parts.path.rstrip("/"), "", ""))

    def ask(self, messages: Sequence[Mapping[str, Any]]) -> str:
        """Send messages and return the text of the model's answer.

        Raises:
            EndpointError: If the answer is late, refused, too long, or not a chat completion.
            SettingError: If the environment variable holds no key.
        """
        key = self._key()
        document = {"model": self.model, "messages": list(messages), "temperature": 0.0, "stream": False}
        parts = _split(self.url)
        url = urlunsplit(parts._replace(path=parts.path.rstrip("/") + "/chat/completions"))
        headers = {"Content-Type": "application/json", "User-Agent": f"graceful_plan/{__version__}"}
        if key:
            headers["Authorization"] = f"Bearer {key}"
        request = urllib.request.Request(url, json.dumps(document).encode(), headers, method="POST")
        try:
            with _opener(parts, time.monotonic() + self.timeout).open(request, timeout=self.timeout) as response:
                content = self._bounded(response)
        except urllib.error.HTTPError as error:
            with error:
                raise EndpointError(self.name, _refusal(error, key)) from None
        except (OSError, HTTPException, ValueError) as error:
            raise EndpointError(self.name, _without(_reason(error, self.timeout), key)) from None
        return _without(self._said(_without(content.decode("utf-8", "replace"), key)), key)

    def without_key(self, text: str) -> str:
        """Remove the key from a text that was decoded from an answer: there, it may have been escaped once more."""
        return _without(text, self._key())

    def _key(self) -> str:
        if self.key_variable is None:
            return ""
        key = os.environ.get(self.key_variable, "").strip()
        # Other characters would break the header line, and the resulting error would show the key.
        if not key or not key.isascii() or not key.isprintable() or " " in key:
            raise SettingError(f"environment variable {self.key_variable}", _HIDDEN, "an API key: letters, no spaces")
        return key

    def _bounded(self, response: HTTPResponse) -> bytes:
        """Read a response with a limit on its size."""
        content = b""
        while part := response.read1(65_536):
            content += part
            if len(content) > MAX_ANSWER:
                raise EndpointError(self.name, f"the answer is longer than {MAX_ANSWER} bytes")
        return content

    def _said(self, text: str) -> str:
        """Extract the text of the answer from the response."""
        try:
            document = json.loads(text)
        except (ValueError, RecursionError):
            raise EndpointError(self.name, f"the answer is not JSON: {_shown(text)}") from None
        try:
            said = document["choices"][0]["message"]["content"]
        except (KeyError, IndexError, TypeError):
            said = None
        if not isinstance(said, str):
            raise EndpointError(self.name, f"the answer has no choices[0].message.content: {_shown(text)}")
        return said


def _split(url: object) -> SplitResult:
    """Split a URL.

    Raises:
        SettingError: If the URL is not allowed as an endpoint.
    """
    expected = "a base URL such as https://host/v1: http or https, without user, password and fragment"
    if not isinstance(url, str) or not url.isascii() or not url.isprintable() or " " in url:
        raise SettingError("endpoint", url, expected)
    try:
        parts = urlsplit(url)
        fine = parts.scheme in ("http", "https") and bool(parts.hostname) and not parts.fragment
        fine = fine and (parts.port is None or parts.port > 0)
    except ValueError:
        raise SettingError("endpoint", url, expected) from None
    if "@" in parts.netloc:
        raise SettingError("endpoint", f"{parts.scheme}://{_HIDDEN}", expected)
    if not fine:
        raise SettingError("endpoint", url, expected)
    return parts


class _TimedFile(io.RawIOBase):
    """Reads from a socket until a moment: the timeout of a socket holds for each read, and a server can trickle."""

    def __init__(self, sock: socket.socket, until: float) -> None:
        self._socket, self._until, self._file = sock, until, sock.makefile("rb", buffering=0)

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any, /) -> int | None:
        remaining = self._until - time.monotonic()
        if remaining <= 0.0:
            raise TimeoutError
        self._socket.settimeout(remaining)
        return self._file.readinto(buffer)

    def close(self) -> None:
        self._file.close()
        super().close()


class _TimedResponse(HTTPResponse):
    """A response whose headers and body arrive before a moment, or not at all."""

    def __init__(self, sock: socket.socket, *args: Any, until: float, **settings: Any) -> None:
        super().__init__(sock, *args, **settings)
        self.fp.close()
        self.fp = io.BufferedReader(_TimedFile(sock, until))


class _Handler(urllib.request.AbstractHTTPHandler):
    """Opens HTTP and HTTPS.

    Args:
        until: Moment by which a response has to be there, on the monotonic clock [s].
    """

    def __init__(self, until: float) -> None:
        super().__init__()
        self.until = until

    def http_open(self, request: urllib.request.Request) -> HTTPResponse:
        return self.do_open(partial(self._connection, HTTPConnection), request)

    def https_open(self, request: urllib.request.Request) -> HTTPResponse:
        return self.do_open(partial(self._connection, HTTPSConnection), request, context=ssl.create_default_context())

    http_request = https_request = urllib.request.AbstractHTTPHandler.do_request_

    def _connection(self, kind: type[HTTPConnection], host: str, **settings: Any) -> HTTPConnection:
        connection = kind(host, **settings)
        connection.response_class = partial(_TimedResponse, until=self.until)  # type: ignore[assignment]
        return connection


def _opener(parts: SplitResult, until: float) -> urllib.request.OpenerDirector:
    """Return an opener for HTTP and HTTPS that opens no files and follows no redirections."""
    opener = urllib.request.OpenerDirector()
    handlers: list[urllib.request.BaseHandler] = [
        _Handler(until),
        urllib.request.HTTPDefaultErrorHandler(),
        urllib.request.HTTPErrorProcessor(),
    ]
    if parts.hostname not in _LOCAL:
        handlers.append(urllib.request.ProxyHandler())
    for handler in handlers:
        opener.add_handler(handler)
    return opener


def _refusal(error: urllib.error.HTTPError, key: str) -> str:
    if 300 <= error.code < 400:
        return f"HTTP {error.code}: it redirects; name the endpoint that it redirects to, if you trust it"
    try:
        said = error.read(4 * _SHOWN).decode("utf-8", "replace")
    except (OSError, HTTPException):
        said = ""
    return f"HTTP {error.code} {error.reason}: {_shown(_without(said, key))}".rstrip(": ")


def _reason(error: Exception, timeout: float) -> str:
    reason = error.reason if isinstance(error, urllib.error.URLError) else error
    if isinstance(reason, TimeoutError):
        return f"no answer within {timeout:g} s"
    return f"{type(reason).__name__}: {reason}" if isinstance(reason, Exception) else str(reason)


def _without(text: str, key: str) -> str:
    """Remove the key from a response, also if characters of it are escaped as in JSON, once or several times."""
    if not key:
        return text
    pattern = "".join(rf"(?:{re.escape(c)}|\\+u00(?i:{ord(c):02x}))" for c in key)
    return re.sub(pattern, _HIDDEN, text)


def _shown(text: str) -> str:
    line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return line if len(line) <= _SHOWN else line[:_SHOWN] + "..."
