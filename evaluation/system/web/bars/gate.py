"""Bar 9: who is not let in, and what a page may say without harm."""

import http.client
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from fleetpose.evaluation.system.web import hands
from fleetpose.evaluation.system.web.bench import Bench
from fleetpose.evaluation.system.web.nonsense import frames_of_nonsense
from fleetpose.evaluation.system.web.rows import Row
from fleetpose.evaluation.system.web.site import BRIDGE, WebSite

FRAMES, QUICK_FRAMES = 10_000, 1_000
_PAGES = 8  # that talk nonsense at the same time
_IN_A_ROW = 15  # the sixteenth would close
_PER_S = 150  # of each, below what is allowed
_TRAVERSALS = (
    "/static/../app.py",
    "/static/%2e%2e/app.py",
    "/static/..%2f..%2fgate.py",
    "/static//etc/passwd",
    "/static/....//app.py",
    "/../../etc/passwd",
)


def who_is_let_in(bench: Bench) -> list[Row]:
    """Foreign pages, strangers, other hosts, files beside, careless starts, and nonsense."""
    site = bench.site
    rows = [*_origins(site), *_tokens(site), *_hosts(site), _traversals(site)]
    bench.said("careless starts")
    rows += _careless_starts(bench)
    return [*rows, *_nonsense(bench)]


# ---- refusals ------------------------------------------------------------------------------------


def _origins(site: WebSite) -> list[Row]:
    """Pages of others, by the header Origin."""
    own = f"http://127.0.0.1:{site.port}"
    told = {
        "foreign": "http://evil.example",
        "null": "null",
        "missing": None,
        "other port": f"http://127.0.0.1:{site.port + 1}",
        "https": own.replace("http", "https"),
    }
    rows = [
        _refused(f"Origin {what}", _handshake(site, origin), 403) for what, origin in told.items()
    ]
    return [*rows, _refused("Origin of the page itself", _handshake(site, own), 101)]


def _hosts(site: WebSite) -> list[Row]:
    """A name of somebody else that points here: DNS rebinding."""
    told = (f"evil.example:{site.port}", "evil.example", f"127.0.0.1:{site.port + 1}")
    answers = {_status(site, "/", host) for host in told}
    return [_refused("Host of a rebinding name", _only(answers), 403)]


def _traversals(site: WebSite) -> Row:
    answers = {_status(site, path) for path in _TRAVERSALS}
    return _refused("paths out of the page's folder", _only(answers), 404)


def _tokens(site: WebSite) -> list[Row]:
    right = site.address().partition("token=")[2]
    wrong = {
        "no": {},
        "empty": {"token": ""},
        "wrong": {"token": right[::-1]},
        "short": {"token": right[:-1]},
        "numeric": {"token": 1},
    }
    codes = {
        what: _close_code(site, {"do": "hello", "v": 1} | told) for what, told in wrong.items()
    }
    silent = _close_code(site, {"do": "next"})
    return [
        _refused("no token, or a wrong one", _only(set(codes.values())), 4401),
        _refused("a command before the token", silent, 4401),
    ]


def _refused(name: str, answer: object, wanted: int) -> Row:
    """A row of an answer that must be this one."""
    return Row(9, name, str(answer), str(wanted), answer == wanted)


def _only(answers: set[Any]) -> object:
    return answers.pop() if len(answers) == 1 else sorted(answers, key=str)


def _handshake(site: WebSite, origin: str | None) -> int:
    """The status that a websocket is answered with."""
    try:
        with _page(site, origin=origin):
            return 101
    except InvalidStatus as error:
        return error.response.status_code


def _status(site: WebSite, path: str, host: str | None = None) -> int:
    """The status of a request whose path goes out as it stands."""
    connection = http.client.HTTPConnection("127.0.0.1", site.port, timeout=5)
    connection.putrequest("GET", path, skip_host=True)
    connection.putheader("Host", host or f"127.0.0.1:{site.port}")
    connection.endheaders()
    status = connection.getresponse().status
    connection.close()
    return status


def _close_code(site: WebSite, first: dict[str, Any]) -> int | None:
    """The code that a page is closed with after its first word; none if it is let in."""
    with _page(site) as page:
        page.send(json.dumps(first))
        try:
            page.recv(timeout=3)
        except ConnectionClosed:
            return page.close_code
        except TimeoutError:
            pass
    return None


def _page(site: WebSite, origin: str | None = "") -> ClientConnection:
    own = f"http://127.0.0.1:{site.port}"
    return connect(
        f"ws://127.0.0.1:{site.port}/ws",
        origin=own if origin == "" else origin,  # pyright: ignore[reportArgumentType]
        compression=None,
    )


def _careless_starts(bench: Bench) -> list[Row]:
    """Beyond this machine: without token file or without TLS nothing is served."""
    tokens = str(bench.site.out / "tokens")
    told = {"without token file and TLS": (), "without TLS": ("--token-file", tokens)}
    return [_start_refused(bench, what, more) for what, more in told.items()]


def _start_refused(bench: Bench, what: str, more: Sequence[str]) -> Row:
    listen = ("--listen", f"0.0.0.0:{bench.site.port + 2}", "--no-open")
    command = [sys.executable, "-P", "-m", "fleetpose.hmi_client", "web", *listen, *more]
    try:
        ended = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    except subprocess.TimeoutExpired:
        return Row(9, f"start beyond loopback {what}", "serves", "refused", False)
    says = "token-file" in ended.stdout + ended.stderr
    refused = ended.returncode != 0 and says
    return Row(
        9, f"start beyond loopback {what}", "refused" if refused else "?", "refused", refused
    )


# ---- nonsense ------------------------------------------------------------------------------------


def _nonsense(bench: Bench) -> list[Row]:
    """Thousands of malformed frames, while a page is open: all counted, both go on."""
    site, total = bench.site, bench.many(FRAMES, QUICK_FRAMES)
    page = bench.browser.page(site.address())
    hands.open_pair(page)
    frames = frames_of_nonsense(total)
    bench.said(f"{total} malformed frames")
    with ThreadPoolExecutor(_PAGES) as pool:
        list(pool.map(lambda k: _say(site, frames[k::_PAGES]), range(_PAGES)))
    counted = _counted(site) - 1
    page.keyboard.press("Space")
    hands.wait_knows(page, "state.list.half")
    page.keyboard.press("Space")
    hands.wait_knows(page, "state.health.confirmed > 0")
    alive = BRIDGE not in site.fleet.exited() and not bench.browser.wrongs(page).console
    return [
        Row(
            9,
            f"malformed frames counted, of {total}",
            float(counted),
            f"= {total}",
            counted == total,
        ),
        Row(9, "bridge and page go on", "yes" if alive else "no", "yes", alive),
    ]


def _say(site: WebSite, frames: Sequence[str | bytes]) -> None:
    """Says malformed frames, a good one now and then so that it may go on, at a rate that is
    allowed."""
    with _page(site) as page:
        _hello(site, page)
        began_s, said = time.monotonic(), 0
        for k, frame in enumerate(frames):
            if k % _IN_A_ROW == 0:
                page.send('{"do":"ping","at":1}')
                said += 1
            page.send(frame)
            said += 1
            time.sleep(max(began_s + said / _PER_S - time.monotonic(), 0.0))
        _until_pong(page, 2)


def _counted(site: WebSite) -> int:
    """How many malformed frames the bridge says that it has had, with this last one."""
    with _page(site) as page:
        _hello(site, page)
        page.send("no command at all")
        end_s = time.monotonic() + 5
        while time.monotonic() < end_s:
            text = page.recv(timeout=5)
            if isinstance(text, str) and "(malformed frame " in text:
                return int(text.rpartition("(malformed frame ")[2].partition(")")[0])
    return 0


def _hello(site: WebSite, page: ClientConnection) -> None:
    token = site.address("bo").partition("token=")[2]
    page.send(json.dumps({"do": "hello", "token": token, "v": 1}))
    page.send('{"do":"want","images":false,"clouds":false,"matrix":false}')


def _until_pong(page: ClientConnection, at: int) -> None:
    """Waits until all that was said before has been heard."""
    page.send(json.dumps({"do": "ping", "at": at}))
    while True:
        text = page.recv(timeout=10)
        if isinstance(text, str) and json.loads(text) == {"t": "pong", "at": at}:
            return
