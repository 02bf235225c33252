"""A process whose clock of the day is wrong, on a machine whose clock is right."""

import subprocess
from pathlib import Path

_CLOCK = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <time.h>

int clock_gettime(clockid_t clock, struct timespec *now) {
    static int (*right)(clockid_t, struct timespec *);
    if (!right) right = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    int failed = right(clock, now);
    if (!failed && clock == CLOCK_REALTIME) now->tv_sec += OFF_S;
    return failed;
}

time_t time(time_t *told) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (told) *told = now.tv_sec;
    return now.tv_sec;
}
"""


def moved_clock(folder: Path, days: float) -> dict[str, str] | None:
    """The environment of a process whose clock is ahead; monotonic time is not touched.

    Args:
        folder: where a small library is built.
        days: ahead; negative: behind.

    Returns:
        None where there is no C compiler.
    """
    source, library = folder / "clock.c", folder / f"clock-{days:g}.so"
    source.write_text(_CLOCK)
    seconds = round(86400 * days)
    command = ["cc", "-shared", "-fPIC", f"-DOFF_S={seconds}", "-o", library, source, "-ldl"]
    try:
        subprocess.run(command, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return {"LD_PRELOAD": str(library)}
