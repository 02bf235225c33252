"""Where recorded data with ground truth lies for tests; it is no part of the repository."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def shared_data(name: str) -> Path:
    """The folder of a recording beside the repository; skips the test where there is none."""
    folder = ROOT.parent / "shared" / "data" / name
    if not folder.is_dir():
        pytest.skip(f"no recorded data: {name}")
    return folder
