"""What a bridge says in each state of the operator's page: frames by the page's contract."""

import functools
import math
import struct
from typing import Any

import cv2
import numpy as np

from fleetpose.hmi_client.desk.colours import MARKER_COLOURS
from fleetpose.hmi_client.model.matrix import QUANTITIES

Frame = dict[str, Any] | bytes
WIDTH, HEIGHT = 960, 640
MARK = (699.5, 299.5)  # the middle of the white block of each image, in its pixels
STATES = {"unknown": 0, "known": 1, "tried": 2}
VERDICTS = ("", "verified", "plausible", "ambiguous", "rejected")
KEYMAP = [
    *(
        ("everywhere", *line)
        for line in (
            ("help", "?", "Help", "all keys and signs"),
            ("next", "n", "Next", "the next question, the most useful one first"),
            ("previous", "p", "Prev", "the question before"),
            ("undo", "u", "Undo", "take the last step back"),
            ("redo", "r", "Redo", "do again what was taken back"),
            ("erase", "x", "Erase", "erase the point near the cursor, or that of the list"),
            ("cancel", "c escape", "Cancel", "drop half a pick, leave suggestions"),
            ("maximise", "m", "Max", "the images only, or all panels"),
            ("why", "y", "Why", "why a robot is located, or not"),
            ("freeze", "f", "Freeze", "hold both images still"),
            ("overview", "o", "Overview", "all pairs at once, in colours"),
            ("events", "l", "Events", "what happened, the newest first"),
            ("hide-more", "[", "Hide", "more errors become a hyphen"),
            ("show-more", "]", "Show", "fewer errors become a hyphen"),
        )
    ),
    *(
        ("images", *line)
        for line in (
            ("pick", "space enter", "Pick", "pick the point under the cursor"),
            ("go", "g", "Go to", "labels on places worth a pick"),
            ("snap", "s", "Snap", "to the nearest corner, or point with depth"),
            ("accept", "tab", "Suggested", "show a suggestion; accept it"),
            ("skip", "shift+tab", "Skip", "skip the suggestion"),
            ("move", "v", "Move", "the nearest point moves to the cursor"),
            ("zoom-in", "+ =", "Zoom", "nearer"),
            ("fit", "0", "Fit", "all of it"),
        )
    ),
    ("matrix", "select", "enter", "Select", "look at the pair under the cursor"),
    ("list", "show", "enter", "Show", "the images that a point was clicked in"),
]


def names(n: int) -> list[str]:
    return [f"r{k}" for k in range(1, n + 1)]


def welcome(settings: dict[str, Any] | None = None) -> Frame:
    keys = [
        {
            "id": id,
            "place": place,
            "keys": keys.split(),
            "label": label,
            "does": does,
            "shown": True,
        }
        for place, id, keys, label, does in KEYMAP
    ]
    return {
        "t": "welcome",
        "v": 1,
        "operator": "kim",
        "site": "demo",
        "version": "0",
        "replay": False,
        "keymap": keys,
        "colours": {"markers": list(MARKER_COLOURS)},
        "quantities": [{"id": q, "title": q} for q in QUANTITIES],
        "settings": settings or {},
    }


def health(**changed: Any) -> Frame:
    told = {
        "t": "health",
        "server": "ok",
        "age_s": 0.2,
        "kept": 0,
        "leg": "",
        "address": "10.0.0.1",
        "located": 7,
        "robots": 8,
        "confirmed": 12,
        "unconfirmed": 0,
    }
    return told | changed


@functools.cache
def image(side: int, view: int) -> bytes:
    """A scene of tiles with a white block on a grey field around `MARK`."""
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    shade = (90 + 50 * ((rows // 32 + columns // 32 + side) % 2) + columns // 24).astype(np.uint8)
    picture = cv2.merge((shade, np.roll(shade, 16, 0), np.roll(shade, 40, 1)))
    picture[236:364, 636:764] = 40
    picture[296:304, 696:704] = 255
    jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    return struct.pack("<BBHI", 1, side, 1, view) + jpeg


def matrix(n: int, chosen: tuple[int, int] | None = None) -> bytes:
    """Neighbours are verified, those farther off through others; the chosen pair is hidden."""
    values, states = [], []
    for a in range(n):
        for b in range(a + 1, n):
            near = min(b - a, n - b + a)
            verdict = 1 if near < n // 8 + 1 else 2 if near < n // 5 + 1 else 0
            hidden = near == n // 5 + 2 and n > 24
            value = 0.08 * near / (1 + n // 16) + 0.003 * (a % 7) if verdict else math.nan
            state = 2 if verdict or hidden else 1 if near < n // 3 else 0
            if (a, b) == chosen:
                value, state, verdict, hidden = 1.24, 2, 3, True
            values.append(value)
            clicked = 32 * ((a, b) == chosen)
            states.append(state | verdict << 2 | clicked | 128 * hidden)
    head = struct.pack("<BBHI", 2, 0, n, 0)
    return head + np.array(values, np.float16).tobytes() + bytes(states)


def places(n: int) -> np.ndarray:
    """x, y, heading of robots on an arc that look at a wall, or on a circle."""
    if n > 24:
        turn = np.arange(n) * 2 * math.pi / n
        return np.stack((12 * np.cos(turn), 12 * np.sin(turn), turn + math.pi / 2), 1)
    across = np.linspace(9, -9, n)
    return np.stack((0.05 * across**2 - 0.5, across, -across / 14), 1)


def poses(n: int, lost: tuple[int, ...] = ()) -> bytes:
    rows = np.full((n, 8), np.nan, np.float32)
    rows[:, 6:] = 0
    for k, place in enumerate(places(n)):
        if k not in lost:
            rows[k] = (*place, 0.01 + 0.002 * k, 0.003, 0.008, 1, 0)
    return struct.pack("<BBHI", 3, 0, n, 0) + rows.tobytes()


@functools.cache
def cloud(k: int, n: int) -> bytes:
    """3000 points of a wall 14 m ahead, in the robot's frame."""
    x, y, heading = places(n)[k]
    rng = np.random.default_rng(k)
    wall = np.stack((np.full(3000, 14.0), rng.uniform(-8, 8, 3000), rng.uniform(-1, 7, 3000)), 1)
    wall[:, 0] += 0.6 * (np.hypot(wall[:, 1] % 5 - 2.5, wall[:, 2] - 1) < 1.8)
    c, s = math.cos(heading), math.sin(heading)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    points = (wall - (x, y, 0)) @ R
    T = np.concatenate((R, [[x], [y], [0]]), 1).astype(np.float32)
    shade = np.clip(110 + 18 * wall[:, 2:] + rng.uniform(-30, 30, (3000, 1)), 0, 255)
    colours = np.repeat(shade, 3, 1).astype(np.uint8)
    head = struct.pack("<BBHI", 4, 0, k, 1) + T.tobytes() + struct.pack("<f", 0.001)
    return head + (points / 0.001).astype(np.int16).tobytes() + colours.tobytes()


def point(n: int, pi: tuple, pj: tuple | None, status: str = "confirmed", **more: Any) -> dict:
    told = {
        "n": n,
        "id": n,
        "status": status,
        "reason": None,
        "pi": pi,
        "pj": pj,
        "by": "kim",
        "residual_m": 0.02 + 0.02 * n if status == "confirmed" else None,
        "depth_i": 14.5,
        "depth_j": 14.6,
        "other_view": False,
    }
    return told | more


def act(do: str, label: str, key: str = "", primary: bool = False, **args: Any) -> dict:
    return {"do": do, "args": args, "label": label, "key": key, "primary": primary}


def step(tone: str, title: str, facts: list[str], *actions: dict) -> Frame:
    return {"t": "step", "tone": tone, "title": title, "facts": facts, "actions": list(actions)}


P1, P2 = ((648.8, 134.1), (205.7, 134.2)), ((571.0, 397.0), (204.0, 396.5))
P3, P4 = ((893.5, 506.0), (450.5, 504.5)), ((923.3, 244.8), (533.3, 177.5))
FACTS = [
    "Why it is asked: nothing joins r8 to the fleet yet; the chance of an overlap is 71 %",
    "What it would gain: r8 is located, and the fleet is known about 0.42 m better",
    "How sure it is now: ambiguous, two poses fit about equally well",
]
FITS = [point(1, *P1), point(2, *P2)]


def listing(pair: tuple[int, int] | None, points: list[dict], **more: Any) -> Frame:
    told = {
        "t": "list",
        "pair": pair,
        "points": points,
        "half": None,
        "frozen": True,
        "kept": 0,
        "confirmed": 12,
        "others": ["ana"],
        "undo": None,
        "redo": None,
        "words": "34 matches speak for one pose, 31 for the other",
    }
    return told | more


def assist(**more: Any) -> Frame:
    told = {
        "t": "assist",
        "side": 1,
        "expected": None,
        "suggestion": None,
        "hints": [],
        "wrong": None,
    }
    return told | more


def fleet(
    n: int = 8, chosen: tuple[int, int] | None = (2, 7), lost: tuple[int, ...] = (7,)
) -> list[Frame]:
    """Everything but step, list, assistance and images."""
    asked = [
        {"i": f"r{i + 1}", "j": f"r{j + 1}", "gain": gain, "why": why}
        for i, j, gain, why in (
            (*(chosen or (5, 6)), 0.42, "joins robots to the fleet"),
            (1, 5, 0.041, "seem to fit, but nothing confirms it"),
            (5, 6, 0.038, "r7 is known to 0.62 m"),
        )
    ]
    pair = chosen or (0, 1)
    told = {
        "t": "pair",
        "i": pair[0],
        "j": pair[1],
        "verdict": "ambiguous",
        "sigma_cm": None,
        "sentence": "Two poses fit about equally well",
        "overlap": 0.26,
        "joined": False,
    }
    events = [
        "server started with 2 workers",
        "r5 joined: 6 of 7 robots are located",
        f"r{pair[0] + 1} - r{pair[1] + 1}: ambiguous",
    ]
    clouds = [cloud(k, n) for k in range(n) if k not in lost] if n <= 24 else []
    return [
        {"t": "names", "names": names(n), "origin": names(n)[0 if n > 24 else 3]},
        matrix(n, chosen),
        poses(n, lost),
        *clouds,
        {"t": "questions", "list": asked},
        *([told] if chosen else []),
        health(located=n - len(lost), robots=n),
        *(
            {"t": "event", "at_ms": 1_790_000_000_000 + 9000 * k, "text": text, "tone": ""}
            for k, text in enumerate(events)
        ),
    ]


def half(n: int = 8, pair: tuple[int, int] = (2, 7), lost: tuple[int, ...] = (7,)) -> list[Frame]:
    done, other = f"r{pair[0] + 1}", f"r{pair[1] + 1}"
    points = [*FITS, point(3, P3[0], None, "half", id=None)]
    guess = {"pixel": [446.6, 503.1], "line": [[330, 502], [560, 505]], "how": "from two points"}
    return [
        *fleet(n, pair, lost),
        listing(pair, points, half={"side": 0, "pixel": P3[0]}, undo="point 3"),
        step(
            "act",
            f"Point picked in {done}: now pick the same point in {other}",
            FACTS,
            act("pick", "Pick here", "Space", True),
            act("snap", "Snap", "S"),
            act("cancel", "Cancel", "C"),
        ),
        image(0, 41),
        image(1, 38),
        assist(expected=guess),
    ]


def suggestion() -> list[Frame]:
    told = {"n": 2, "of": 8, "pi": P4[0], "pj": P4[1], "depth_i": 14.5, "depth_j": 14.6}
    return [
        *fleet(),
        listing((2, 7), [*FITS, point(3, *P3)]),
        image(0, 41),
        image(1, 38),
        step(
            "ask",
            "Do both crosses show the same point?",
            ["What this is: the server found these two by their looks"],
            act("accept", "Yes, the same", "Tab", True),
            act("skip", "No, next", "⇧Tab"),
            act("cancel", "Leave", "C"),
        ),
        assist(suggestion=told),
    ]


def wrong() -> list[Frame]:
    bad = point(2, P2[0], (321.0, 459.5), "outlier", residual_m=3.5, reason="3.5 m off")
    told = {
        "id": 2,
        "side": 1,
        "clicked": [321.0, 459.5],
        "fits": [203.2, 397.0],
        "off_m": 3.5,
        "off_px": 133,
        "text": "3.5 m off",
    }
    return [
        *fleet(),
        listing((2, 7), [point(1, *P1), bad, point(3, *P3)], undo="point 3 in r3 and r8"),
        image(0, 41),
        image(1, 38),
        step(
            "warn",
            "Point 2 does not fit the others: 3.5 m off",
            ["What to do: if the ◇ shows the same as r3, move it there; else erase it"],
            act("move", "Move it to the ◇", "V", True, id=2, side=1, pixel=[203.2, 397.0]),
            act("erase", "Erase it", "X", id=2),
        ),
        assist(wrong=told),
    ]


def gone() -> list[Frame]:
    kept = [point(1, *P1), point(2, *P2, "pending"), point(3, *P3, "pending")]
    return [
        *fleet(),
        listing((2, 7), kept, kept=2),
        image(0, 41),
        image(1, 38),
        step("gone", "NO SERVER", []),
        assist(),
        health(server="gone", age_s=14, kept=2, unconfirmed=2, leg="server"),
    ]


def idle() -> list[Frame]:
    done = step(
        "done",
        "All 8 robots are located.",
        ["Least sure: r7, to 0.62 m"],
        act("why", "Look at r7", "Y", robot="r7"),
    )
    return [*fleet(8, None, ()), listing(None, [], words="", frozen=False), done, assist()]


def without_image() -> list[Frame]:
    waits = step(
        "wait",
        "Waiting for the image of r8",
        ["asked for it 6 s ago"],
        act("next", "Next question", "N", True),
    )
    return [*fleet(), listing((2, 7), [], frozen=False), image(0, 41), waits, assist()]


def many() -> list[Frame]:
    return half(72, (38, 40), (40, 41, 42, 57))
