"""Applies updates to a journal as fast as it can and prints a receipt for each; it is to be killed.

Usage: python -m tests.pose_server.journal_child JOURNAL
"""

import sys
from pathlib import Path

import numpy as np

from fleetpose.pose_server.correspondences.journal import Journal
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.protocol.messages import OperatorUpdate, ViewName
from tests.pose_server.correspondence_makers import EPOCH, add, keeps, lift, update, view


def nth(n: int) -> OperatorUpdate:
    """The n-th update, always the same: two clicks, one of them erased, one rejected, and again."""
    k, step = divmod(n - 1, 4)
    pair = ("r1", f"r{2 + k // 400}")
    if step == 2:
        return update("erase", n, 0.0, *pair, correspondence=2 * k)
    if step == 3:
        return add(n, 700.0, *pair)
    row = np.array([5.0, 2.0 * (k % 400)])
    return add(n, 100.0 * step, *pair, view_i=view("r1", n % 97), pixel_j=row)


def encoded(name: ViewName) -> bytes:
    """Stands for the bytes of a view."""
    return str(name).encode() * 200


def main() -> None:
    """Runs until killed."""
    book = CorrespondenceStore(Journal(Path(sys.argv[1])))
    n = book.receipts(nth(1), EPOCH).n
    while True:
        n += 1
        for outcome in book.apply(nth(n), keeps, lift, encoded):
            print(outcome.n, flush=True)


if __name__ == "__main__":
    main()
