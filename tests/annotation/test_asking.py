import base64
import contextlib
import json
import re
import socket
import struct
import threading

import pytest
from places import ROOT

import graceful_plan as gp
from graceful_plan.annotation.annotations import Annotations
from graceful_plan.annotation.endpoint import MAX_ANSWER, Endpoint
from graceful_plan.exceptions import AnnotationError, EndpointError, SceneError, SettingError
from graceful_plan.scene.harm.severity import SeverityTable
from graceful_plan.viz import offscreen
from support.annotation.model_server import asked_about, guesses, rows, said

KEY = "sk-not-a-real-key-0123456789"


def ask(room, server, **settings):
    return gp.annotate(room, "stub", endpoint=server.url, **{"pictures": False, **settings})


def test_every_entity_is_in_a_request_and_an_answer(room, server):
    found = ask(room, server, together=3)
    assert [asked_about(document) for document in server.asked] == [["floor", "vase", "mug"], ["inside"]]
    assert list(found.rows) == list(room.entities)
    assert (found.scene, found.model, found.endpoint, found.pictures) == ("room", "stub", server.url, False)
    assert found.rows["mug"].severity == {
        c: SeverityTable.shipped().rows["glass"].get(c, 0.0) for c in SeverityTable.shipped().components
    }
    assert server.paths == ["/v1/chat/completions"] * 2
    assert all(document["model"] == "stub" and document["stream"] is False for document in server.asked)
    assert not any("Authorization" in headers for headers in server.headers)


def test_the_question_has_sizes_scales_and_names_but_no_row_of_the_table(room, server):
    ask(room, server)
    [document] = server.asked
    told = json.loads(document["messages"][1]["content"])
    assert told["entities asked about"]["vase"]["size [m]"] == "0.2 x 0.2 x 0.2"
    assert told["entities asked about"]["floor"]["size [m]"] == "a plane without end"
    assert set(told["columns of severity"]) == set(SeverityTable.shipped().components)
    assert "carried" not in told["classes"] and "heirloom" in told["classes"]
    assert not re.search(r"heirloom\W+\d", json.dumps(told))


def test_pictures_show_each_entity_outlined(room, server):
    with offscreen.canvas(room.model, 8, 8) as opened:
        if opened is None:
            pytest.skip("no OpenGL works here without a window")
    assert ask(room.edit(remove=["floor", "mug"]), server, pictures=True).pictures
    parts = server.asked[0]["messages"][1]["content"]
    named = [part["text"] for part in parts[1:] if part["type"] == "text"]
    urls = [part["image_url"]["url"] for part in parts if part["type"] == "image_url"]
    assert named.count("vase, outlined in red:") == 2 and len(urls) == len(named)
    assert not any(name.startswith("inside") for name in named)  # it is not visible
    sizes = [struct.unpack(">II", base64.b64decode(url.removeprefix("data:image/png;base64,"))[16:24]) for url in urls]
    assert sizes == [(384, 288)] * 2


def test_without_opengl_pictures_are_omitted_with_a_notice(room, server, monkeypatch):
    monkeypatch.setattr(offscreen, "_context", lambda width, height: None)
    assert not ask(room, server, pictures=True).pictures
    assert isinstance(server.asked[0]["messages"][1]["content"], str)


def test_a_bad_answer_gets_one_complaint_and_may_be_mended(room, server):
    def careless(document):
        return guesses(document) if len(server.asked) == 2 else said('{"entities": {}}')

    server.replies = careless
    assert set(ask(room, server).rows) == set(room.entities)
    again = server.asked[1]["messages"]
    assert [message["role"] for message in again] == ["system", "user", "assistant", "user"]
    assert "'vase'" in again[-1]["content"]


def test_a_second_bad_answer_is_an_error_with_names(room, server):
    server.replies = lambda document: said('{"entities": {"ghost": 1}}')
    with pytest.raises(AnnotationError, match="'vase'") as caught:
        ask(room, server)
    assert len(server.asked) == 2
    assert any("'ghost'" in problem for problem in caught.value.problems)


def test_a_scene_without_entities_is_refused_before_anything_is_sent(room, server):
    with pytest.raises(SceneError, match="no entities"):
        ask(room.edit(remove=list(room.entities)), server)
    assert server.asked == []


@pytest.mark.parametrize("together", [0, -1, True])
def test_how_many_at_once_is_a_count(room, server, together):
    with pytest.raises(SettingError, match="together"):
        ask(room, server, together=together)


# --- the key ----------------------------------------------------------------------------------------------------------


def test_the_key_goes_to_the_server_and_into_nothing_else(room, server, monkeypatch, tmp_path):
    monkeypatch.setenv("MY_KEY", KEY)

    def echo(document):
        found = rows(asked_about(document))
        found["vase"]["reason"] = f"you sent {server.headers[-1]['Authorization']}"
        return said(json.dumps({"entities": found}))

    server.replies = echo
    found = ask(room, server, key_variable="MY_KEY")
    assert server.headers[0]["Authorization"] == f"Bearer {KEY}"
    found.save(tmp_path / "s.yaml")
    assert "***" in found.rows["vase"].reason
    assert KEY not in repr(found) + (tmp_path / "s.yaml").read_text()
    assert KEY not in repr(Endpoint(url=server.url, model="m", key_variable="MY_KEY"))


@pytest.mark.parametrize("status", [400, 401, 500])
def test_a_refusal_does_not_show_the_key(room, server, monkeypatch, status):
    monkeypatch.setenv("MY_KEY", KEY)
    server.replies = lambda document: (status, {}, f"incorrect key {KEY}".encode())
    with pytest.raises(EndpointError, match=rf"{status}.*\*\*\*") as caught:
        ask(room, server, key_variable="MY_KEY")
    assert KEY not in str(caught.value) and caught.value.__suppress_context__


@pytest.mark.parametrize("value", [None, "", " ", "two words", "line\nbreak", "schlüssel"])
def test_a_variable_without_a_key_is_refused_without_showing_it(room, server, monkeypatch, value):
    monkeypatch.delenv("MY_KEY", raising=False)
    if value is not None:
        monkeypatch.setenv("MY_KEY", value)
    with pytest.raises(SettingError, match=r"MY_KEY.*'\*\*\*'"):
        ask(room, server, key_variable="MY_KEY")
    assert server.asked == []


def test_a_key_in_the_place_of_the_name_is_not_shown():
    with pytest.raises(SettingError, match="key") as caught:
        Endpoint(url="https://host/v1", model="m", key_variable=KEY)
    assert KEY not in str(caught.value)


def test_a_key_does_not_go_over_plain_http_to_another_machine():
    with pytest.raises(SettingError, match="https"):
        Endpoint(url="http://host/v1", model="m", key_variable="MY_KEY")
    Endpoint(url="http://host/v1", model="m")


def test_redirections_are_not_followed(room, server, monkeypatch):
    monkeypatch.setenv("MY_KEY", KEY)
    server.replies = lambda document: (307, {"Location": server.url + "/elsewhere"}, b"")
    with pytest.raises(EndpointError, match="307"):
        ask(room, server, key_variable="MY_KEY")
    assert len(server.asked) == 1


# --- misbehaving servers ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "url",
    [
        "file:///etc/passwd",
        "ftp://host/v1",
        "data:text/plain,hello",
        "host/v1",
        "",
        "http://",
        "http://host:port/v1",
        "http://host:0/v1",
        "https://host/v1#here",
        "https://ho st/v1",
        "https://host/v1\r\nX: y",
        "http://[::1/v1",
    ],
)
def test_an_invalid_url_is_refused(room, url):
    with pytest.raises(SettingError, match="endpoint"):
        gp.annotate(room, "m", endpoint=url, pictures=False)


def test_a_password_in_a_url_is_refused_and_not_shown():
    with pytest.raises(SettingError, match="without user, password") as caught:
        Endpoint(url="https://me:secret@host/v1", model="m")
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "value"), [("model", ""), ("model", " "), ("timeout", 0.0), ("timeout", float("nan"))]
)
def test_settings_of_an_endpoint_are_checked(name, value):
    with pytest.raises(SettingError, match=name):
        Endpoint(**{"url": "https://host/v1", "model": "m", name: value})


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (b"<html>hello</html>", "the answer is not JSON: <html>hello</html>"),
        (b"\xff\xfe\x00", "the answer is not JSON"),
        (b"", "the answer is not JSON"),
        (b"[" * 100_000, "the answer is not JSON"),
        (b"[]", r"has no choices\[0\].message.content"),
        (b'{"choices": []}', "has no choices"),
        (b'{"choices": [{"message": {"content": null}}]}', "has no choices"),
        (b'{"error": {"message": "no such model"}}', "no such model"),
    ],
)
def test_an_invalid_answer_is_an_error(room, server, body, message):
    server.replies = lambda document: (200, {}, body)
    with pytest.raises(EndpointError, match=message) as caught:
        ask(room, server)
    assert len(str(caught.value)) < 500


def test_an_endless_answer_is_cut_off(room, server):
    server.replies = lambda document: (200, {}, b" " * (MAX_ANSWER + 1_000_000))
    with pytest.raises(EndpointError, match=f"{MAX_ANSWER}"):
        ask(room, server)


def test_a_silent_server_times_out(room, server):
    answered = threading.Event()

    def sleepy(document):
        answered.wait(10.0)
        return guesses(document)

    server.replies = sleepy
    with pytest.raises(EndpointError, match=r"0\.2 s"):
        ask(room, server, timeout=0.2)
    answered.set()


def test_a_missing_server_is_an_error(room, server):
    closed = server.url.replace(server.url.split(":")[2].split("/")[0], "9")
    with pytest.raises(EndpointError, match=r"ConnectionRefusedError|OSError"):
        gp.annotate(room, "m", endpoint=closed, pictures=False)


# --- the guide ------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_the_guide_annotate_md_runs(server, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MY_KEY", KEY)
    text = (ROOT / "docs" / "annotate.md").read_text()
    snippets = re.findall(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    known = {"gp": gp}
    for snippet in snippets:
        assert "https://models.example/v1" in snippet or "endpoint" not in snippet
        exec(compile(snippet.replace("https://models.example/v1", server.url), "annotate.md", "exec"), known)
    assert isinstance(known["said"], Annotations) and server.asked


@pytest.fixture
def trickling():
    """Start servers on a socket that send a text byte by byte, as slowly that all of it takes minutes."""
    listening, stop = [], threading.Event()

    def serve(listener, text, slow_from):
        with contextlib.suppress(OSError):
            connection, _ = listener.accept()
            with connection:
                connection.recv(65_536)
                connection.sendall(text[:slow_from])
                for byte in text[slow_from:]:
                    if stop.wait(0.05):
                        return
                    connection.sendall(bytes([byte]))

    def start(text, slow_from):
        listener = socket.create_server(("127.0.0.1", 0))
        listening.append(listener)
        threading.Thread(target=serve, args=(listener, text, slow_from), daemon=True).start()
        return f"http://127.0.0.1:{listener.getsockname()[1]}/v1"

    yield start
    stop.set()
    for listener in listening:
        listener.close()


@pytest.mark.parametrize("part", ["status", "header", "body", "chunks", "refusal"])
def test_a_server_that_trickles_is_not_waited_for(room, trickling, part):
    long = b"X-Long: " + b"x" * 5000 + b"\r\n"
    head = b"HTTP/1.1 500 Broken\r\n" if part == "refusal" else b"HTTP/1.1 200 OK\r\n"
    body = b"Content-Length: 5000\r\n\r\n" + b" " * 5000
    if part == "chunks":
        body = b"Transfer-Encoding: chunked\r\n\r\n" + b"1\r\n \r\n" * 5000
    slow_from = {"status": 3, "header": len(head) + 20}.get(part, len(head) + len(long) + 30)
    url = trickling(head + long + body, slow_from)
    said = "HTTP 500 Broken$" if part == "refusal" else r"no answer within 0\.3 s"
    with pytest.raises(EndpointError, match=said):
        gp.annotate(room, "stub", endpoint=url, pictures=False, timeout=0.3)


def escaped(text, again=0):
    """Write every character as JSON escapes it, once or several times over."""
    return "".join("\\" * 2**again + f"u{ord(c):04X}" for c in text)


@pytest.mark.parametrize("times", [0, 1, 2])
def test_an_escaped_key_is_not_kept(room, server, monkeypatch, tmp_path, times):
    monkeypatch.setenv("SOME_KEY", KEY)

    def telling(document):
        found = {name: {**row, "reason": "REASON"} for name, row in rows(asked_about(document)).items()}
        status, headers, body = said(json.dumps({"entities": found}))
        return status, headers, body.replace(b"REASON", escaped(KEY, times).encode())

    server.replies = telling
    found = ask(room, server, key_variable="SOME_KEY")
    assert all("***" in row.reason for row in found.rows.values())
    found.save(tmp_path / "a.yaml")
    for text in ((tmp_path / "a.yaml").read_text(), repr(found), str(found.to_document())):
        assert KEY not in text and KEY not in text.encode().decode("unicode_escape")


@pytest.mark.parametrize("times", [0, 1, 2])
def test_an_escaped_key_is_not_shown_in_errors(room, server, monkeypatch, times):
    monkeypatch.setenv("SOME_KEY", KEY)
    _, headers, body = said('{"entities": {"NAME": 3}}')
    server.replies = lambda _: (200, headers, body.replace(b"NAME", escaped(KEY, times).encode()))
    with pytest.raises(AnnotationError) as caught:
        ask(room, server, key_variable="SOME_KEY")
    server.replies = lambda _: (500, {}, escaped(KEY).encode())
    with pytest.raises(EndpointError) as refused:
        ask(room, server, key_variable="SOME_KEY")
    for text in (str(caught.value), str(refused.value)):
        assert "***" in text and KEY not in text and KEY not in text.encode().decode("unicode_escape")
