"""Pages of other sites cannot reach the viewer, neither directly nor by DNS rebinding."""

import asyncio
import http.client
import socket
from types import SimpleNamespace

import pytest

import graceful_plan as gp
from graceful_plan.exceptions import GracefulPlanError
from graceful_plan.viewer.browser import guarded_server as module
from graceful_plan.viewer.browser.guarded_server import is_own

sockets = pytest.importorskip("websockets.asyncio.server")
client = pytest.importorskip("websockets.asyncio.client")
exceptions = pytest.importorskip("websockets.exceptions")


@pytest.mark.parametrize(
    ("host", "origin", "own"),
    [
        ("localhost:8080", "http://localhost:8080", True),
        ("LOCALHOST:8080", "http://localhost:8080", True),
        ("127.0.0.1:8080", "http://127.0.0.1:8080", True),
        ("[::1]:8080", "http://[::1]:8080", True),
        ("192.168.1.7:8080", "http://192.168.1.7:8080", True),
        ("localhost:9000", "http://localhost:9000", True),  # a tunnel
        ("localhost:8080", "https://localhost:8080", True),
        (f"{socket.gethostname()}:8080", f"http://{socket.gethostname()}:8080", True),
        ("robot.lab:8080", "http://robot.lab:8080", True),
        ("localhost:8080", None, True),  # a program, or the page itself
        ("localhost:8080", "http://evil.example", False),
        ("127.0.0.1:8080", "http://localhost:8080", False),
        ("localhost:8080", "http://localhost:9000", False),
        ("localhost:8080", "null", False),
        ("evil.example:8080", "http://evil.example:8080", False),  # rebound to this machine
        ("evil.example", None, False),
        ("localhost.evil.example:8080", "http://localhost.evil.example:8080", False),
        ("[::1", None, False),
        ("", None, False),
    ],
)
def test_only_the_own_page_is_served(host, origin, own):
    assert is_own([host], [] if origin is None else [origin], "robot.lab") is own


def test_ambiguous_headers_are_refused():
    good, own = "localhost:8080", "http://localhost:8080"
    assert is_own([good], [own], "127.0.0.1")
    assert not is_own([good, "evil.example"], [own], "127.0.0.1")
    assert not is_own([], [own], "127.0.0.1")
    assert not is_own([good], [own, "http://evil.example"], "127.0.0.1")


async def _answer(url, **headers):
    """Return what a websocket at an address says: its first message, or the status of a refusal."""
    try:
        async with client.connect(url, proxy=None, additional_headers=headers) as connection:
            return await connection.recv()
    except exceptions.InvalidStatus as error:
        return error.response.status_code


def test_a_foreign_page_gets_no_message_from_a_guarded_server():
    def viser_http_server(connection, request):
        return None

    viser_http_server.__module__ = "viser.infra"
    guard = module._Guard(sockets.serve, "127.0.0.1")

    async def talk():
        async def say(connection):
            await connection.send("the scene")

        async with guard(say, "127.0.0.1", 0, process_request=viser_http_server) as server:
            port = server.sockets[0].getsockname()[1]
            url = f"ws://127.0.0.1:{port}"
            return [
                await _answer(url, Origin=f"http://127.0.0.1:{port}"),
                await _answer(url),
                await _answer(url, Origin="http://evil.example"),
                await _answer(url, Origin="null"),
            ]

    assert asyncio.run(talk()) == ["the scene", "the scene", 403, 403]
    assert guard.used


def test_servers_of_others_are_left_alone():
    guard, given = module._Guard(lambda *args, **settings: settings, "127.0.0.1"), object()
    assert guard(process_request=given) == {"process_request": given}
    assert not guard.used


def test_a_viser_that_cannot_be_guarded_is_not_served(monkeypatch):
    stopped = []

    class ViserServer:
        def __init__(self, **_):
            self.stop = lambda: stopped.append(self)

    modules = {"viser": SimpleNamespace(ViserServer=ViserServer), "websockets.asyncio.server": sockets}
    monkeypatch.setattr(module.importlib, "import_module", modules.__getitem__)
    serve = sockets.serve
    with pytest.raises(GracefulPlanError, match="not supported"):
        module.guarded_server(host="127.0.0.1", port=0)
    assert len(stopped) == 1 and sockets.serve is serve


@pytest.fixture(scope="module")
def viewer():
    pytest.importorskip("viser")
    with gp.view("tabletop", task="lift_to_goal", port=8450, time_limit=0.1) as viewer:
        yield viewer


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_the_viewer_refuses_foreign_pages_and_rebound_names(viewer):
    import viser

    page = viewer._page.server
    port = page.get_port()
    protocol = f"viser-v{viser.__version__}"

    async def first(**headers):
        try:
            async with client.connect(
                f"ws://localhost:{port}", proxy=None, subprotocols=[protocol], additional_headers=headers
            ) as connection:
                return type(await connection.recv())
        except exceptions.InvalidStatus as error:
            return error.response.status_code

    assert asyncio.run(first(Origin=f"http://localhost:{port}")) is bytes
    assert asyncio.run(first(Origin="http://evil.example")) == 403

    def status(host):
        connection = http.client.HTTPConnection("localhost", port, timeout=20)
        connection.request("GET", "/", headers={"Host": host})
        status = connection.getresponse().status
        connection.close()
        return status

    assert (status(f"localhost:{port}"), status(f"evil.example:{port}")) == (200, 403)
