"""One record, one line; a file under a screen."""

import logging

import pytest

from fleetpose.protocol.logs import OneLine, log_to_file

FORGED = "name=r1\n2026-01-01T00:00:00.000Z ERROR pose_server forged\x1b[2J"


def record(text: str, **extra) -> logging.LogRecord:
    return logging.makeLogRecord({"msg": "%s", "args": (text,), "name": "a", "created": 0, **extra})


def test_no_text_forges_a_line():
    line = OneLine().format(record(FORGED))
    assert "\n" not in line and "\x1b" not in line
    assert line.startswith("1970-01-01T00:00:00.") and "Z " in line and "forged" in line


def test_a_traceback_keeps_its_lines():
    try:
        raise ValueError("here")
    except ValueError as error:
        text = OneLine().format(record("failed", exc_info=(ValueError, error, error.__traceback__)))
    assert len(text.splitlines()) > 2 and text.endswith("ValueError: here")


@pytest.fixture
def root():
    logger = logging.getLogger()
    before = logger.handlers[:], logger.level
    yield logger
    for handler in logger.handlers:
        handler.close()
    logger.handlers[:], logger.level = before


def test_a_file_takes_all_that_is_logged(tmp_path, root):
    path = tmp_path / "made" / "hmi.log"
    log_to_file(path)
    logging.getLogger("anything").warning("heard name=%s", "r1")
    assert path.read_text().endswith("WARNING anything heard name=r1\n")
