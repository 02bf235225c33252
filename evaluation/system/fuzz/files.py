"""Damaged calibrations and lists: each is read or refused by a sentence, in less than a second."""

import random
import re
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from fleetpose.evaluation.bench.cameras import layouts
from fleetpose.evaluation.bench.cameras.calibrations import FILES
from fleetpose.evaluation.bench.cameras.made.known import SIZE
from fleetpose.evaluation.report import output
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.robot_agent.cameras.calibrations.reading import read_rig_file
from fleetpose.robot_agent.cameras.rgbd.intrinsics import read_intrinsics
from fleetpose.robot_agent.cameras.rgbd.recording import open_camera

SLOW_S = 1.0
_HUNG_S = 10.0
_TOLD = 20
_DEEDS = 3  # at most, on one file
_NUMBER = re.compile(rb"-?\d+\.?\d*(?:e[+-]?\d+)?")
_NUMBERS = (b"nan", b"inf", b"-inf", b"1e308", b"-0", b"0", b"1e-320", b"9" * 400, b"0x1f", b"1,5")
_WORDS = (b"null", b"[]", b"{}", b"!!python/object:os.system", b"&a [*a, *a]", b"\x00", b"\xff\xfe")

Reader = Callable[[Path], object]


@dataclass(frozen=True)
class Subject:
    """One good file and what reads it.

    Attributes:
        path: the file, which is damaged in place and put right again.
        opened: what is given to the reader: the file, or its folder.
    """

    path: Path
    opened: Path
    reader: Reader


def run(count: int, out: Path, seed: int = 0) -> dict[str, Any]:
    """Damages so many files, one at a time; returns the summary and writes it."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    chance, found = random.Random(seed), Counter[str]()
    ended: list[str] = []
    slowest_s = 0.0
    with tempfile.TemporaryDirectory(prefix="fleetpose-") as scratch, _bounded():
        subjects = _subjects(Path(scratch))
        for _ in range(count):
            subject = chance.choice(subjects)
            kind, seconds = _tried(subject, chance)
            slowest_s = max(slowest_s, seconds)
            known = kind in ("read", "refused")
            found[kind if known else "ended"] += 1
            found["slow"] += seconds > SLOW_S
            if (not known or seconds > SLOW_S) and len(ended) < _TOLD:
                name = f"{subject.path.parent.name}/{subject.path.name}"
                ended.append(f"{name}: {kind} after {seconds:.2f} s")
    summary = {
        "files": count,
        "counted": found["read"] + found["refused"] + found["ended"],
        **{name: found[name] for name in ("read", "refused", "ended", "slow")},
        "slowest_ms": 1e3 * slowest_s,
        "endings": ended,
    }
    output.write_summary(output.output_folder(out), summary)
    output.print_table("damaged files", ("what", "value"), output.scalars(summary))
    for line in ended:
        print(line)
    return summary


def passed(summary: dict[str, Any]) -> bool:
    """Whether all were counted, nothing ended otherwise, and nothing took long."""
    all_counted = summary["counted"] == summary["files"]
    return all_counted and not summary["ended"] and not summary["slow"]


def damaged(chance: random.Random, good: bytes) -> bytes:
    """A file as bad disks, editors, copying and other tools leave it."""
    content = good
    for _ in range(chance.randint(1, _DEEDS)):
        content = chance.choice(_WAYS)(chance, content)
    return content


def _tried(subject: Subject, chance: random.Random) -> tuple[str, float]:
    good = subject.path.read_bytes()
    subject.path.write_bytes(damaged(chance, good))
    began_s = time.perf_counter()
    signal.setitimer(signal.ITIMER_REAL, _HUNG_S)
    try:
        subject.reader(subject.opened)
        kind = "read"
    except FleetPoseError:
        kind = "refused"
    except Exception as error:  # each is a bug, which is what is looked for
        kind = f"{type(error).__name__}: {str(error)[:120]}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        subject.path.write_bytes(good)
    return kind, time.perf_counter() - began_s


@contextmanager
def _bounded() -> Iterator[None]:
    def hung(*_: object) -> None:
        raise TimeoutError(f"more than {_HUNG_S:g} s")

    before = signal.signal(signal.SIGALRM, hung)
    try:
        yield
    finally:
        signal.signal(signal.SIGALRM, before)


def _subjects(scratch: Path) -> list[Subject]:
    """Files of every tool, and what lies in folders of colour and depth."""
    found = []
    for expected in FILES:
        opened = expected.write(scratch / expected.write.__name__)
        size = SIZE if expected.rig is None else expected.rig.size

        def read(path: Path, size: tuple[int, int] = size) -> object:
            return read_rig_file(path, size)

        found += [Subject(path, opened, read) for path in opened.parent.iterdir() if path.is_file()]
    for variant in layouts.VARIANTS:
        if variant.kind != "rgbd":
            continue
        folder = scratch / "folders" / variant.name
        folder.mkdir(parents=True)
        variant.write(folder)
        for path in sorted(folder.rglob("*.txt")) + sorted(folder.rglob("*.json")):
            found.append(Subject(path, folder, lambda at: open_camera(str(at), "once")))
            if "intrin" in path.name or "cam" in path.name:
                found.append(Subject(path, path, read_intrinsics))
    return found


def _cut(chance: random.Random, content: bytes) -> bytes:
    return content[: chance.randrange(len(content) + 1)]


def _flipped(chance: random.Random, content: bytes) -> bytes:
    bits = bytearray(content)
    for _ in range(chance.randint(1, 8)):
        if bits:
            bits[chance.randrange(len(bits))] ^= 1 << chance.randrange(8)
    return bytes(bits)


def _other_number(chance: random.Random, content: bytes) -> bytes:
    found = list(_NUMBER.finditer(content))
    if not found:
        return content
    at = chance.choice(found)
    return content[: at.start()] + chance.choice(_NUMBERS + _WORDS) + content[at.end() :]


def _lines(chance: random.Random, content: bytes) -> bytes:
    lines = content.split(b"\n")
    k = chance.randrange(len(lines))
    deed = chance.randrange(4)
    if deed == 0:
        del lines[k]
    elif deed == 1:
        lines.insert(k, lines[chance.randrange(len(lines))])
    elif deed == 2:
        lines[k] = b" " * chance.randrange(9) + lines[k].strip()
    else:
        lines[k] = chance.choice(_WORDS)
    return b"\n".join(lines)


def _other_ends(chance: random.Random, content: bytes) -> bytes:
    return content.replace(b"\n", chance.choice((b"\r\n", b"\r", b"\n\n", b"\t", b"")))


def _marked(chance: random.Random, content: bytes) -> bytes:
    return chance.choice((b"\xef\xbb\xbf", b"\xff\xfe", b"\x00", b"\n\n")) + content


def _long(chance: random.Random, content: bytes) -> bytes:
    nest = chance.choice((b"[", b"{", b"- ", b"a: ", b"1 ", b"<a>"))
    return content + nest * chance.choice((100, 5000))


_WAYS = (
    *(_cut, _flipped, _flipped, _other_number, _other_number, _lines, _lines),
    *(_other_ends, _marked, _long),
)
