"""Reads a calibration's file as names with values, whatever it is written in: JSON, YAML (OpenCV's
dialect too), OpenCV's XML, sections of `name=value`, or lines of `name=value`.
"""

import configparser
import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fleetpose.protocol.errors import CalibrationError
from fleetpose.robot_agent.cameras.folders.files import text_of

MAX_BYTES = 4 * 1024 * 1024
_MOST_VALUES = 200_000
_OPENCV_HEADER = re.compile(r"\A\s*%YAML[^\n]*\n")  # of a kind that YAML itself does not know
_TIGHT = re.compile(r"^(\s*[\w.]+):(?=[\[{])", re.MULTILINE)  # `data:[1` is no map to YAML
_DEEP = re.compile(r"(?:[\[{]\s*){64}|(?:- ?){64} |(?:\w+: ?){64}|(?:<\w+>\s*){64}")
_SECTION = re.compile(r"\A\s*\[[\w ]+\]\s*$", re.MULTILINE)
_ASSIGNED = re.compile(r"\A\s*\w+\s*=")


def read_tree(path: Path) -> dict[str, Any]:
    """The names and values of a file; keys are strings.

    Raises:
        CalibrationError: it cannot be read; the sentence says where it breaks.
    """
    text = _text_of(path)
    if _DEEP.search(text):
        raise CalibrationError(f"{path} is nested deeper than any calibration")
    start = text.lstrip()[:1]
    if start == "{":
        content = _json(path, text)
    elif start == "<":
        content = _opencv(path)
    elif _SECTION.match(text):
        content = _sections(path, text)
    elif _ASSIGNED.match(text):
        content = _assigned(text)
    else:
        content = _yaml(path, text)
    if not _ends(content):
        raise CalibrationError(f"{path} holds itself, or more than any calibration")
    if not isinstance(content, dict) or not content:
        raise CalibrationError(f"{path} holds no names with matrices")
    return {str(name): value for name, value in content.items()}


def _ends(content: Any) -> bool:
    """Whether what lies in it can be counted: YAML's aliases can lead back to themselves."""
    waiting, seen = [content], 0
    while waiting and seen <= _MOST_VALUES:
        value = waiting.pop()
        seen += 1
        if isinstance(value, dict):
            waiting += value.values()
        elif isinstance(value, list):
            waiting += value
    return not waiting


def _text_of(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise CalibrationError(f"{path} is larger than any calibration")
        return text_of(path)
    except (OSError, ValueError) as error:
        raise CalibrationError(f"{path} cannot be read: {error}") from error


def _json(path: Path, text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise CalibrationError(f"{path} cannot be read as JSON: {error}") from error


def _yaml(path: Path, text: str) -> Any:
    import yaml  # of no other use

    class Loader(yaml.SafeLoader):
        """Takes OpenCV's matrices for the maps that they are."""

    Loader.add_multi_constructor(
        "tag:yaml.org,2002:opencv", lambda loader, _, node: loader.construct_mapping(node, True)
    )
    text = _TIGHT.sub(r"\1: ", _OPENCV_HEADER.sub("", text.expandtabs(2)))
    try:
        return next(iter(yaml.load_all(text, Loader)), None)  # of `topic echo`, the first message
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise CalibrationError(f"{path} cannot be read as YAML: {error}") from error


def _opencv(path: Path) -> dict[str, Any]:
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        if not storage.isOpened():
            raise CalibrationError(f"{path} cannot be read as an OpenCV file")
        root = storage.root()
        content = {name: _value(root.getNode(name)) for name in root.keys()}  # noqa: SIM118
    except (cv2.error, SystemError) as error:
        raise CalibrationError(f"{path} cannot be read as an OpenCV file") from error
    storage.release()
    return {name: value for name, value in content.items() if value is not None}


def _value(node: cv2.FileNode) -> Any:
    if node.isMap():
        try:
            return np.asarray(node.mat()).tolist()
        except (cv2.error, SystemError):  # a map that is no matrix says nothing of cameras
            return None
    if node.isInt() or node.isReal():
        return node.real()
    if node.isString():
        return node.string()
    if node.isSeq():
        return [node.at(i).real() for i in range(node.size())]
    return None


def _sections(path: Path, text: str) -> dict[str, Any]:
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    try:
        parser.read_string(text)
    except configparser.Error as error:
        raise CalibrationError(f"{path} cannot be read: {error}") from error
    return {name: dict(parser[name]) for name in parser.sections()}


def _assigned(text: str) -> dict[str, Any]:
    rows = (line.partition("=") for line in text.splitlines() if "=" in line)
    return {name.strip(): value.strip(" []").replace(";", " ") for name, _, value in rows}
