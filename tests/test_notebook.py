"""The notebook runs from top to bottom, and shows a pose that is right."""

import json
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest

NOTEBOOK = Path(__file__).parent.parent / "examples" / "registration.ipynb"
CELLS = json.loads(NOTEBOOK.read_text())["cells"]
CODE = [cell for cell in CELLS if cell["cell_type"] == "code"]


@pytest.fixture(scope="module")
def ran():
    """The names that its cells leave."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    names: dict[str, Any] = {}
    for cell in CODE:
        exec(compile("".join(cell["source"]), f"cell {cell['id']}", "exec"), names)
    yield names
    pyplot.close("all")


def test_the_pose_it_shows_is_right_and_as_sure_as_it_should_be(ran):
    found, sigma_m = ran["found"], np.sqrt(np.linalg.eigvalsh(ran["covariance"])[-1])
    assert found.verdict == "verified"
    assert ran["error_m"] < min(4 * sigma_m, 0.01 * ran["world"].radius_m)


def test_it_draws_matches_residuals_and_covariances(ran):
    from matplotlib import pyplot

    assert len(pyplot.get_fignums()) == 3
    assert ran["scored"].inliers.sum() > 50 and (~ran["scored"].inliers).any()
    assert np.std(ran["across_px"]) < 2 * ran["pair"].pixel_px


def test_no_output_is_kept():
    assert not any(cell["outputs"] or cell["execution_count"] for cell in CODE)
