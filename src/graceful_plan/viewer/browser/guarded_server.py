"""A viser server that refuses requests from pages of other sites.

A browser lets any page connect to a websocket on this machine, and a name that an attacker controls may resolve to this
machine, too (DNS rebinding). viser checks neither header, so every page open in a browser could read the scene.
"""

from __future__ import annotations

import contextlib
import http
import importlib
import io
import ipaddress
import socket
from collections.abc import Callable
from functools import partial
from typing import Any
from urllib.parse import urlsplit

from graceful_plan.exceptions import GracefulPlanError

_REFUSAL = "This page is served only to itself: open it by the address that the program prints.\n"


def guarded_server(*, host: str, port: int, label: str | None = None) -> Any:
    """Start a viser server whose pages and websockets answer only to requests from its own page.

    Raises:
        GracefulPlanError: If the installed version of viser cannot be guarded; it is then not served.
    """
    viser: Any = importlib.import_module("viser")
    sockets: Any = importlib.import_module("websockets.asyncio.server")
    serve, guard = sockets.serve, _Guard(sockets.serve, host)
    sockets.serve = guard  # viser has no parameter for the check, and serves before its constructor returns
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # suppresses viser's messages on the terminal
            server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
    finally:
        sockets.serve = serve
    if not guard.used:
        server.stop()
        raise GracefulPlanError("this version of viser is not supported: requests from other sites cannot be refused")
    return server


class _Guard:
    """Stands in for `websockets.asyncio.server.serve` and adds a check to the servers of viser.

    Args:
        serve: The function that it stands in for.
        listening: Name or address that viser listens at.
    """

    def __init__(self, serve: Callable[..., Any], listening: str) -> None:
        self.serve, self.listening, self.used = serve, listening, False

    def __call__(self, *args: Any, **settings: Any) -> Any:
        module = str(getattr(settings.get("process_request"), "__module__", ""))
        if module.partition(".")[0] == "viser":  # other threads may serve as well
            self.used = True
            settings["process_request"] = partial(_checked, settings["process_request"], self.listening)
        return self.serve(*args, **settings)


def _checked(process: Callable[[Any, Any], Any], listening: str, connection: Any, request: Any) -> Any:
    """Refuse a request from another site, else let viser process it."""
    hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
    if not is_own(hosts, origins, listening):
        return connection.respond(http.HTTPStatus.FORBIDDEN, _REFUSAL)
    return process(connection, request)


def is_own(hosts: list[str], origins: list[str], listening: str) -> bool:
    """Return whether a request comes from a page of this server, or from a program that is not a browser.

    Args:
        hosts: Values of the header Host: the address by which the browser reached the server.
        origins: Values of the header Origin: the site of the page. Browsers send it with every websocket.
        listening: Name or address that the server listens at.
    """
    if len(hosts) != 1 or len(origins) > 1:
        return False
    try:
        name = urlsplit(f"//{hosts[0]}").hostname or ""
    except ValueError:
        return False
    known = name in ("localhost", listening.lower(), socket.gethostname().lower())
    # Only names can be rebound, addresses cannot.
    return (known or _is_address(name)) and all(
        origin.lower() in (f"http://{hosts[0].lower()}", f"https://{hosts[0].lower()}") for origin in origins
    )


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
