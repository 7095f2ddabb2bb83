"""Linux calls that Python lacks: parent-death signal, child subreaper and a socket's peer."""

import ctypes
import os
import socket
import struct

_PR_SET_PDEATHSIG = 1
_PR_SET_CHILD_SUBREAPER = 36
_UCRED = struct.Struct("3i")  # pid, uid, gid: unix(7), SO_PEERCRED

_libc = ctypes.CDLL(None, use_errno=True)


def set_parent_death_signal(number: int) -> None:
    """Have the kernel send this signal to the caller when its parent ends; 0 asks for none.

    It survives `exec` and is not passed on by `fork` (prctl(2), PR_SET_PDEATHSIG). A parent that
    ended before the call goes unnoticed: compare `os.getppid()` afterwards. Raises `OSError`.
    """
    _prctl(_PR_SET_PDEATHSIG, number)


def become_subreaper() -> None:
    """Make orphaned descendants children of the caller instead of init's. Raises `OSError`."""
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)


def peer_of(connection: socket.socket) -> tuple[int, int]:
    """The (process id, user id) that connected this Unix socket. Raises `OSError`."""
    credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _UCRED.size)
    pid, uid, _ = _UCRED.unpack(credentials)
    return pid, uid


def _prctl(option: int, value: int) -> None:
    if _libc.prctl(option, ctypes.c_ulong(value), 0, 0, 0) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"prctl({option}): {os.strerror(number)}")
