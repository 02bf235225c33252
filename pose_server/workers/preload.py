"""The process that workers are forked from: what they import, 2 s of CPU, is imported once for all
of them, beside the server's own imports. This module itself imports nothing heavy.
"""

import os
from multiprocessing import forkserver, get_context
from multiprocessing.context import BaseContext

IMPORTED = ["fleetpose.pose_server.workers.run"]


def use_one_thread() -> None:
    """Has libraries that are loaded from now on compute in one thread, here and in the workers:
    these are the parallelism, and a fork copies no threads.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def start() -> BaseContext:
    """Starts it, unless it runs already; returns the context that forks workers from it.

    It ends with its last worker, and each worker with this process.
    """
    use_one_thread()
    context = get_context("forkserver")
    context.set_forkserver_preload(IMPORTED)
    forkserver.ensure_running()
    return context
