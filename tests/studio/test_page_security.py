"""Nobody frames the pages, and nobody but they themselves asks for anything."""

import asyncio
import base64
import http.client
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")

from tests.studio.served_page import TOKEN

from palpate.studio.page_security import HEADERS, TokenGate, names_of_server, refusal
from palpate.studio.page_server import HEADER

MAX_S = 60.0
CSP = "content-security-policy"
POLLING = "/_nicegui_ws/socket.io/?EIO=4&transport=polling"
SOCKET = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"


class Served:
    """The server, in a process of its own, before a made-up rig."""

    def __init__(self, **environment):
        with socket.create_server(("127.0.0.1", 0)) as probe:
            self.port = probe.getsockname()[1]
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("served_page.py")), str(self.port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=self._environment() | environment,
        )
        end_s = time.monotonic() + MAX_S
        while time.monotonic() < end_s and self.process.poll() is None:
            try:
                return socket.create_connection(("127.0.0.1", self.port), 5).close()
            except OSError:
                time.sleep(0.05)
        raise AssertionError("the server did not start")

    def _environment(self):
        """Variables of the server: it answers over a workspace, with address files, that no other has."""
        given = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST")}
        self._own = tempfile.TemporaryDirectory()
        if "RUNTIME" not in given:
            given["XDG_RUNTIME_DIR"] = self._own.name
        self.addresses = Path(given["XDG_RUNTIME_DIR"]) / "palpate"
        self.workspace = Path(given.setdefault("WORKSPACE", str(Path(self._own.name) / "workspace")))
        self.token = given.setdefault("TOKEN", TOKEN)
        return given | {"ADDRESSES": str(self.addresses)}

    def url(self, path="/"):
        """Address of a page, with the token."""
        mark = "&" if "?" in path else "?"
        return f"http://127.0.0.1:{self.port}{path}{mark}token={self.token}"

    def tell(self, line):
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def ask(self, method, path, host=None, body=None, **headers):
        """Status, headers and text of an answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        try:
            connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            if host != "":
                connection.putheader("Host", host or f"localhost:{self.port}")
            headers.setdefault("Cookie", f"palpate-token-{self.port}={self.token}")
            for name, value in headers.items():
                connection.putheader(name.replace("_", "-"), value)
            if body is not None:
                connection.putheader("Content-Length", str(len(body)))
            connection.endheaders(body)
            answer = connection.getresponse()
            upgraded = answer.status == 101
            return answer.status, answer.headers, "" if upgraded else answer.read().decode("latin-1")
        finally:
            connection.close()

    def handshake(self, path=SOCKET, **headers):
        """The same of a socket's handshake."""
        key = base64.b64encode(os.urandom(16)).decode()
        upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec_WebSocket_Version": "13"}
        return self.ask("GET", path, **{**upgrade, "Sec_WebSocket_Key": key, **headers})

    def close(self):
        self.process.kill()
        self.process.communicate()
        self._own.cleanup()


@pytest.fixture
def served(plain_served):
    return plain_served


def own(served, name="localhost"):
    return f"http://{name}:{served.port}"


def is_guarded(headers):
    policies = headers.get_all("content-security-policy")
    return all(headers.get_all(name) == [value] for name, value in HEADERS.items() if name != CSP) and [
        one.startswith(HEADERS[CSP]) for one in policies
    ] == [True]


def test_every_answer_forbids_frames_errors_and_refused_sockets_too(served):
    page = served.ask("GET", "/")
    assert page[0] == 200
    assets = set(re.findall(r"""["'(](/_nicegui/[^"')]+\.(?:js|css))""", page[2]))
    assert len(assets) > 3
    answers = {path: served.ask("GET", path) for path in assets}
    assert {answer[0] for answer in answers.values()} == {200}
    answers |= {
        "page": page,
        "picture": served.ask("GET", "/picture"),
        "head": served.ask("HEAD", "/"),
        "missing": served.ask("GET", "/nowhere"),
        "missing asset": served.ask("GET", "/_nicegui/0/static/nothing.js"),
        "wrong method": served.ask("GET", "/estop"),
        "stop": served.ask("POST", "/estop", **{HEADER: "estop"}),
        "bare stop": served.ask("POST", "/estop"),
        "polling": served.ask("GET", POLLING),
        "bad polling": served.ask("GET", POLLING + "&sid=none"),
        "options": served.ask("OPTIONS", "/estop"),
        "other host": served.ask("GET", "/", host="elsewhere.example"),
        "other origin": served.ask("POST", POLLING, Origin="http://elsewhere.example"),
        "socket": served.handshake(Origin=own(served)),
        "refused socket": served.handshake(Origin="http://elsewhere.example"),
        "socket elsewhere": served.handshake("/nowhere", Origin=own(served)),
        "page socket": served.handshake("/", Origin=own(served)),
    }
    status = {name: answer[0] for name, answer in answers.items()}
    wanted = {"page": 200, "picture": 200, "missing": 404, "missing asset": 404, "wrong method": 404}
    wanted |= {"stop": 200, "bare stop": 403, "polling": 200, "bad polling": 400}
    wanted |= {"other host": 400, "other origin": 403, "socket": 101, "refused socket": 403}
    assert {name: status[name] for name in wanted} == wanted
    assert status["socket elsewhere"] >= 400
    assert status["page socket"] >= 400
    assert [name for name, answer in answers.items() if not is_guarded(answer[1])] == []


FOREIGN = (
    "http://elsewhere.example",
    "https://localhost:{port}",  # another scheme
    "http://localhost:{other}",  # another server of this machine
    "http://localhost",
    "http://localhost:{port}.elsewhere.example",
    "http://localhost.elsewhere.example:{port}",
    "http://127.0.0.1.elsewhere.example:{port}",
    "http://user@localhost:{port}",
    "http://localhost:{port}/",
    "http://192.168.1.2:{port}",
    "file://",
    "null",
    "",
)


def test_pages_of_its_own_address_are_answered_by_each_name_of_this_machine(served):
    for name in ("localhost", "127.0.0.1", "[::1]", "LOCALHOST"):
        assert served.handshake(Origin=own(served, name))[0] == 101
        assert served.ask("GET", POLLING, Origin=own(served, name))[0] == 200
        assert served.ask("GET", "/", host=f"{name}:{served.port}")[0] == 200
    assert served.handshake()[0] == 101  # of a program: browsers always say for whom they ask
    assert served.ask("GET", POLLING)[0] == 200


@pytest.mark.parametrize("foreign", FOREIGN)
def test_pages_from_elsewhere_open_no_socket_and_post_nothing(served, foreign):
    origin = foreign.format(port=served.port, other=served.port + 1)
    assert served.handshake(Origin=origin)[0] == 403
    assert served.ask("GET", POLLING, Origin=origin)[0] == 403
    assert served.ask("POST", POLLING + "&sid=any", body=b"40", Origin=origin)[0] == 403
    assert served.ask("POST", "/", body=b"", Origin=origin)[0] == 403
    assert served.ask("OPTIONS", POLLING, Origin=origin, Access_Control_Request_Method="POST")[0] == 403
    assert "Access-Control-Allow-Origin" not in served.ask("GET", POLLING, Origin=origin)[1]


@pytest.mark.parametrize(
    "host", ["elsewhere.example", "localhost.elsewhere.example", "127.0.0.2", "a@localhost"]
)
def test_a_name_from_elsewhere_that_is_made_to_point_here_gets_nothing(served, host):
    at = f"{host}:{served.port}"
    assert served.ask("GET", "/", host=at)[0] == 400
    assert served.ask("GET", "/picture", host=at)[0] == 400
    assert served.handshake(host=at, Origin=f"http://{at}")[0] == 400
    assert served.ask("GET", POLLING, host=at)[0] == 400


def test_what_another_site_embeds_is_refused_and_a_link_that_is_followed_is_not(served):
    def asked(path, site, mode, dest):
        return served.ask("GET", path, Sec_Fetch_Site=site, Sec_Fetch_Mode=mode, Sec_Fetch_Dest=dest)[0]

    assert asked("/", "cross-site", "navigate", "document") == 200
    assert asked("/", "none", "navigate", "document") == 200
    assert asked("/picture", "same-origin", "no-cors", "image") == 200
    for site in ("cross-site", "same-site"):
        assert asked("/", site, "navigate", "iframe") == 403
        assert asked("/picture", site, "no-cors", "image") == 403
        assert asked(POLLING, site, "no-cors", "script") == 403
        assert served.handshake(Sec_Fetch_Site=site, Sec_Fetch_Mode="websocket")[0] == 403


def test_an_emergency_stop_is_refused_to_nobody_who_sends_its_header(served):
    # Not for the address that it was asked at, which a proxy may change, nor for what an extension strips.
    asked = {HEADER: "estop"}
    assert served.ask("POST", "/estop", **asked)[0] == 200
    assert served.ask("POST", "/estop", host="elsewhere.example", **asked)[0] == 200
    assert served.ask("POST", "/estop", Origin="null", Sec_Fetch_Site="cross-site", **asked)[0] == 200
    # Without the header, which no other page may send, it was not asked for by the page. A browser asks first
    # whether another page may send it, and is not told so.
    assert served.ask("POST", "/estop", Origin="http://elsewhere.example")[0] == 403
    before = served.ask(
        "OPTIONS",
        "/estop",
        Origin="http://elsewhere.example",
        Access_Control_Request_Method="POST",
        Access_Control_Request_Headers=HEADER,
    )
    assert before[0] >= 400
    assert not [name for name in before[1] if name.lower().startswith("access-control")]


def scope(kind="http", scheme="http", **headers):
    names = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    return {"type": kind, "scheme": scheme, "path": "/", "method": "POST", "headers": names}


def test_two_hosts_or_one_foreign_origin_among_several_are_refused():
    good = scope(host="localhost:8080", origin="http://127.0.0.1:8080")
    assert refusal(good) is None
    assert refusal({**good, "headers": [*good["headers"], (b"host", b"localhost:8080")]})[0] == 400
    assert refusal({**good, "headers": [*good["headers"], (b"Origin", b"http://elsewhere")]})[0] == 403
    assert refusal(scope())[0] == 400
    assert refusal(scope("websocket", "wss", host="localhost", origin="https://localhost:443")) is None
    assert refusal(scope("websocket", "ws", host="localhost", origin="http://[::1]:80")) is None


def test_a_server_answers_to_the_address_that_it_listens_at_and_to_no_other():
    names = names_of_server("10.1.2.3")
    good = scope(host="10.1.2.3:8080", origin="http://10.1.2.3:8080")
    assert refusal(good, names) is None
    assert refusal(good) is not None  # where it was not said
    assert refusal(scope(host="10.1.2.4:8080"), names)[0] == 400
    assert refusal(scope(host="rebound.example:8080"), names)[0] == 400
    assert refusal(scope(host="10.1.2.3:8080", origin="http://10.1.2.4:8080"), names)[0] == 403
    assert refusal(scope(host="10.1.2.3:8080", origin="http://10.1.2.3:8081"), names)[0] == 403
    assert refusal(scope(host="10.1.2.3:8080", origin="https://10.1.2.3:8080"), names)[0] == 403


def test_a_server_at_every_address_answers_to_numbers_and_its_own_name_but_not_to_anothers():
    names = names_of_server("0.0.0.0")
    for own_name in ("10.1.2.3", "[fe80::1]", "localhost", socket.gethostname().lower()):
        assert names(own_name), own_name
    assert refusal(scope(host="rebound.example:8080"), names)[0] == 400
    # Another machine's page, at a number too, is not this one's.
    assert refusal(scope(host="10.1.2.3:8080", origin="http://10.9.9.9:8080"), names)[0] == 403


def gated(kind="http", method="GET", path="/rig", query="", cookie=""):
    """What a gate answers: the status, the headers; or "let in" where the application is asked."""
    sent, asked = [], []

    async def app(scope, receive, send):
        asked.append(scope)

    async def send(message):
        sent.append(message)

    headers = [(b"cookie", cookie.encode())] if cookie else []
    request = {
        "type": kind,
        "method": method,
        "path": path,
        "query_string": query.encode(),
        "headers": headers,
    }
    asyncio.run(TokenGate(app, TOKEN, 8080)(request, None, send))
    if asked:
        return "let in", {}
    if kind == "websocket":
        return sent[0]["type"], {}
    return sent[0]["status"], {k.decode(): v.decode() for k, v in sent[0]["headers"]}


def test_nobody_without_the_token_gets_a_page_a_socket_a_picture_or_a_stop():
    right, wrong = f"palpate-token-8080={TOKEN}", f"palpate-token-8080={TOKEN[:-1]}x"
    for cookie in (
        "",
        wrong,
        f"palpate-token-8081={TOKEN}",
        f"palpate-token-8080={TOKEN}x",
        "palpate-token-8080=",
    ):
        assert gated(cookie=cookie)[0] == 401
        assert gated(path="/picture", cookie=cookie)[0] == 401
        assert gated(path="/estop", method="POST", cookie=cookie)[0] == 401
        assert gated("websocket", cookie=cookie)[0] == "websocket.close"
    assert gated(cookie=right)[0] == "let in"
    assert gated(cookie=f"other=1; {right}")[0] == "let in"
    assert gated(path="/estop", method="POST", cookie=right)[0] == "let in"
    assert gated("websocket", cookie=right)[0] == "let in"


def test_the_token_in_an_address_becomes_a_cookie_and_leaves_the_address():
    status, headers = gated(query=f"run=a%20b&token={TOKEN}&frame=3")
    assert (status, headers["location"]) == (303, "/rig?run=a+b&frame=3")
    cookie = headers["set-cookie"]
    assert cookie.startswith(f"palpate-token-8080={TOKEN};")
    assert "httponly" in cookie.lower()
    assert "samesite=strict" in cookie.lower()
    assert gated(path="//elsewhere.example/", query=f"token={TOKEN}")[1]["location"] == "/elsewhere.example/"
    for query in (f"token={TOKEN}x", "token=", f"token={TOKEN}&token={TOKEN}", "token=%ff"):
        assert gated(query=query)[0] == 401
    assert gated(query=f"token={TOKEN}", method="POST")[0] == 401
