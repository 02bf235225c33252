"""Who is let in, and what becomes of the rest."""

import sys
from collections import Counter
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="starlette is not installed: pip install 'fleetpose[web]'")
pytest.importorskip("httpx", reason="httpx is not installed")
sys.path.insert(0, str(Path(__file__).parent))

from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.web.app import HEADERS, MOST_PAGES, make_app
from fleetpose.hmi_client.web.gate import Address, Gate, check_reach, own_token, read_tokens
from fleetpose.hmi_client.web.heard import MalformedError, parse

HOST, ORIGIN = "127.0.0.1:8642", "http://127.0.0.1:8642"
TOKEN = "0123456789abcdef"
HELLO = {"do": "hello", "token": TOKEN, "v": 1}


class SilentLink:
    """A desk that only hears."""

    def __init__(self) -> None:
        from fleetpose.hmi_client.web.outlook import Outlook, Pictures

        self.outlook, self.pictures = Outlook(), Pictures()
        self.events, self.cloud_of, self.done = [], {}, []

    def welcome(self):
        return {"t": "welcome"}

    def join(self, guest):
        self.guest = guest

    def leave(self, guest):
        self.guest = None

    def do(self, guest, heard):
        self.done.append(heard.do)


@pytest.fixture
def counts():
    return Counter()


@pytest.fixture
def link():
    return SilentLink()


@pytest.fixture
def client(link, counts):
    gate = Gate.at(Address.of(HOST), {TOKEN: "kim"}, secure=False)
    return TestClient(make_app(gate, lambda operator: link, counts), base_url=ORIGIN)


def test_every_answer_tells_the_browser_to_load_nothing_from_elsewhere(client):
    for path, status in (("/", 200), ("/static/main.js", 200), ("/nothing", 404)):
        answer = client.get(path)
        assert answer.status_code == status
        assert {name: answer.headers[name] for name in HEADERS} == HEADERS
    refused = client.get("/", headers={"host": "evil.example:8642"})
    assert {name: refused.headers[name] for name in HEADERS} == HEADERS


@pytest.mark.parametrize(
    "host", ["evil.example:8642", "127.0.0.1:80", "127.0.0.1", "", "10.0.0.1:8642"]
)
def test_a_name_that_only_points_here_is_refused(client, host):
    assert client.get("/static/x", headers={"host": host}).status_code == 403


@pytest.mark.parametrize(
    "path", ["/static/../app.py", "/static/%2e%2e/app.py", "/static/..%2fgate.py", "//etc/passwd"]
)
def test_no_path_leads_out_of_the_page(client, path):
    assert client.get(path).status_code == 404


def test_pages_are_only_read(client):
    assert client.post("/", headers={"origin": ORIGIN}).status_code == 405


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", None, "http://127.0.0.1:8643", "https://127.0.0.1:8642", ""],
)
def test_only_pages_of_this_address_open_the_websocket(client, counts, origin):
    headers = {"host": HOST} | ({} if origin is None else {"origin": origin})
    with pytest.raises(WebSocketDisconnect), client.websocket_connect("/ws", headers=headers):
        pass
    assert counts["refused"] == 1


def opened(client):
    return client.websocket_connect("/ws", headers={"origin": ORIGIN, "host": HOST})


@pytest.mark.parametrize(
    ("hello", "code"),
    [
        ({"do": "hello", "v": 1}, 4401),
        (HELLO | {"token": "wrong"}, 4401),
        (HELLO | {"token": TOKEN + "\u00e9"}, 4401),
        ({"do": "next"}, 4401),
        (HELLO | {"v": 2}, 4400),
    ],
)
def test_without_the_token_nobody_comes_in(client, hello, code):
    with opened(client) as page:
        page.send_json(hello)
        with pytest.raises(WebSocketDisconnect) as closed:
            page.receive_text()
    assert closed.value.code == code


def test_malformed_frames_are_counted_and_told_and_end_only_their_page(client, link, counts):
    with opened(client) as page:
        page.send_json(HELLO)
        assert page.receive_json() == {"t": "welcome"}
        for n, bad in enumerate(MALFORMED, start=1):
            page.send_text(bad)
            told = page.receive_json()
            assert told["t"] == "notice" and f"malformed frame {n}" in told["text"]
            page.send_json({"do": "ping", "at": 1})
            assert page.receive_json() == {"t": "pong", "at": 1}
        for _ in range(15):
            page.send_text("[")
            page.receive_json()
        page.send_bytes(b"\x00")
        with pytest.raises(WebSocketDisconnect) as closed:
            page.receive_json()
    assert closed.value.code == 4400
    assert counts["malformed"] == len(MALFORMED) + 16
    assert link.done == []
    with opened(client) as page:
        page.send_json(HELLO)
        assert page.receive_json() == {"t": "welcome"}


MALFORMED = (
    *("", "[", "[]", "1", "null", '"pick"', "{}", '{"do": 1}', '{"do": "no-such"}', "[" * 60_000),
    *('{"do": "pick", "side": 2}', '{"do": "pick", "side": true}', '{"do": "pick", "seen": 1}'),
    *(
        '{"do": "pick", "pixel": [1]}',
        '{"do": "pick", "pixel": [NaN, 1]}',
        '{"do": "ack", "view": -1}',
    ),
    '{"do": "pick", "pixel": [1' + "0" * 400 + ", 1]}",
    *('{"do": "pick", "pixel": [1e999, 1]}', '{"do": "select", "a": ["r1"], "b": "r2"}'),
    '{"do": "why", "robot": "' + "r" * 300 + '"}',
    *('{"do": "settings", "set": 1}', '{"do": "hello", "v": 1}', '{"do": "want", "images": 1}'),
)


def test_too_many_commands_close_the_page(client, counts):
    with opened(client) as page:
        page.send_json(HELLO)
        page.receive_json()
        for _ in range(300):
            page.send_json({"do": "next"})
        with pytest.raises(WebSocketDisconnect) as closed:
            page.receive_json()
    assert closed.value.code == 4429 and counts["too many commands"] == 1


def test_so_many_pages_and_no_more(client):
    from contextlib import ExitStack

    with ExitStack() as pages:
        for _ in range(MOST_PAGES):
            page = pages.enter_context(opened(client))
            page.send_json(HELLO)
            page.receive_json()
        with opened(client) as one_more:
            one_more.send_json(HELLO)
            with pytest.raises(WebSocketDisconnect) as closed:
                one_more.receive_json()
        assert closed.value.code == 4429
    with opened(client) as page:
        page.send_json(HELLO)
        assert page.receive_json() == {"t": "welcome"}


def test_a_pixel_and_a_pair_are_heard_as_they_were_said():
    heard = parse('{"do": "pick", "side": 1, "pixel": [1.5, 2], "view": 7}')
    assert (heard.do, heard.args) == ("pick", {"side": 1, "pixel": [1.5, 2], "view": 7})
    assert parse('{"do":"select","a":"r1","b":"\\ud800"}').args["a"] == "r1"
    with pytest.raises(MalformedError, match="no-such"):
        parse('{"do": "no-such"}')


# ---- addresses and tokens ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "address", ["0.0.0.0:8642", "192.168.1.4:8642", "[::]:8642", "robot-pc:8642"]
)
def test_beyond_this_machine_token_file_and_certificate_are_needed(tmp_path, address):
    file = tmp_path / "file"
    file.touch()
    for given in ((None, None, None), (file, None, None), (None, file, file)):
        with pytest.raises(OperatorError, match=r"--token-file.*--certificate.*ssh -L 8642"):
            check_reach(Address.of(address), *given)
    check_reach(Address.of(address), file, file, file)
    check_reach(Address.of("127.0.0.1:8642"), None, None, None)
    with pytest.raises(OperatorError, match="--certificate and --key"):
        check_reach(Address.of("127.0.0.1:8642"), None, file, None)


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("127.0.0.1:9", "127.0.0.1", 9),
        ("[::1]:9", "::1", 9),
        ("localhost", "localhost", 8642),
        ("[::1]", "::1", 8642),
    ],
)
def test_addresses_are_read(text, host, port):
    assert Address.of(text) == Address(host, port)
    assert Address.of(text).is_loopback


@pytest.mark.parametrize("text", ["", ":1", "127.0.0.1:", "127.0.0.1:x", "a:70000"])
def test_what_is_no_address_is_refused(text):
    with pytest.raises(OperatorError, match="HOST:PORT"):
        Address.of(text)


def test_a_token_names_its_operator(tmp_path):
    file = tmp_path / "tokens"
    file.write_text(f"# ours\n\nkim: {TOKEN}\nana:{TOKEN[::-1]}\n")
    with pytest.raises(OperatorError, match="chmod 600"):
        read_tokens(file)
    file.chmod(0o600)
    gate = Gate.at(Address.of(HOST), read_tokens(file), secure=False)
    assert gate.operator_of(TOKEN[::-1]) == "ana"
    assert [gate.operator_of(t) for t in ("", None, TOKEN[:-1], TOKEN + "0")] == [None] * 4


@pytest.mark.parametrize(
    "line", ["kim", "kim:short", f"Kim/x:{TOKEN}", f"a:{TOKEN}\nb:{TOKEN}", ""]
)
def test_a_wrong_line_of_tokens_is_refused(tmp_path, line):
    from fleetpose.protocol.errors import FleetPoseError

    file = tmp_path / "tokens"
    file.write_text(line)
    file.chmod(0o600)
    with pytest.raises(FleetPoseError):
        read_tokens(file)


def test_the_own_token_outlives_a_restart_and_is_nobody_elses(tmp_path):
    token = own_token(tmp_path / "state" / "web-token")
    file = tmp_path / "state" / "web-token"
    assert len(token) >= 32 and file.stat().st_mode & 0o777 == 0o600
    assert own_token(file) == token
    file.chmod(0o644)
    assert own_token(file) != token
