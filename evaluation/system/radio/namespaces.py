"""Network namespaces without names: each lives as long as a process in it or a file that refers to
it, so that nothing is left behind, however its maker ends.
"""

import ctypes
import os
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from fleetpose.protocol.errors import FleetPoseError

_NEW_NETWORK = 0x40000000  # CLONE_NEWNET, see unshare(2); `os.unshare` is there from Python 3.12 on
_HERE = "/proc/thread-self/ns/net"
_TUN = Path("/dev/net/tun")
_SYSCTL = Path("/proc/sys")
_libc = ctypes.CDLL(None, use_errno=True)


class Namespace:
    """A network of its own, with nothing in it but its loopback interface.

    Attributes:
        path: by which other processes can enter it, while this object is open.
    """

    def __init__(self) -> None:
        """Makes it; the calling thread stays where it is.

        Raises:
            FleetPoseError: the machine does not allow it.
        """
        before = os.open(_HERE, os.O_RDONLY)
        try:
            _checked(_libc.unshare(_NEW_NETWORK), "network namespaces")
            try:
                run("ip", "link", "set", "lo", "up")
                self._file = os.open(_HERE, os.O_RDONLY)
            finally:
                _enter(before)
        finally:
            os.close(before)
        self.path = f"/proc/{os.getpid()}/fd/{self._file}"

    @contextmanager
    def entered(self) -> Iterator[None]:
        """The calling thread, and the processes that it starts, are in there."""
        before = os.open(_HERE, os.O_RDONLY)
        try:
            _enter(self._file)
            yield
        finally:
            _enter(before)
            os.close(before)

    def close(self) -> None:
        """Lets go of it: it is gone with the last process in it."""
        os.close(self._file)


def enter(path: str) -> None:
    """Takes the calling thread into a network, and with it what it starts from now on."""
    file = os.open(path, os.O_RDONLY)
    _enter(file)
    os.close(file)


def _enter(file: int) -> None:
    _checked(_libc.setns(file, _NEW_NETWORK), "entering a network namespace")


def _checked(result: int, what: str) -> None:
    if result != 0:
        raise FleetPoseError(f"{what}: {os.strerror(ctypes.get_errno())}; run this as root")


def run(*command: str) -> None:
    """Runs a command of the system.

    Raises:
        FleetPoseError: it is missing or fails.
    """
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        said = getattr(error, "stderr", None) or str(error)
        raise FleetPoseError(f"{' '.join(command)}: {said.strip()}") from error


def set_kernel(told: Mapping[str, str]) -> None:
    """Sets the kernel for the network of the calling thread, by the names of `sysctl`.

    Raises:
        FleetPoseError: the kernel does not take a value.
    """
    for name, value in told.items():
        try:
            _SYSCTL.joinpath(*name.split(".")).write_text(value)
        except OSError as error:
            raise FleetPoseError(f"{name} = {value}: {error.strerror}") from error


def why_impossible() -> str:
    """Why no radio link can be emulated on this machine; empty if it can."""
    if not os.access(_TUN, os.R_OK | os.W_OK):
        return f"{_TUN} is not there, or not ours"
    try:
        Namespace().close()
    except FleetPoseError as error:
        return str(error)
    return ""
