"""What `make test-fast` leaves out is there to be left out."""

from pathlib import Path

from tests.conftest import MEASURED

HERE = Path(__file__).parent


def test_every_test_that_was_measured_is_there():
    gone = set()
    for one in MEASURED:
        file, _, name = one.partition("::")
        said = (HERE / file).read_text() if (HERE / file).is_file() else ""
        if not said or (name and f"def {name}(" not in said):
            gone.add(one)
    assert not gone
