"""Children and process groups as the kernel knows them: ended, alive, killed."""

import contextlib
import os
import signal

_OUT_OF_REACH = (ProcessLookupError, PermissionError)  # ended, or of another user by setuid


def ended_child() -> int | None:
    """The id of a child that has ended and is not reaped yet, None if there is none."""
    try:
        found = os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return None
    return None if found is None else found.si_pid


def kill_group(group: int) -> None:
    """Kill all processes of a group; nothing if it has none."""
    with contextlib.suppress(*_OUT_OF_REACH):
        os.killpg(group, signal.SIGKILL)


def kill(pid: int, group: int | None) -> None:
    """Kill a process and its group, but not the caller's own group."""
    if group is not None and group != os.getpgrp():
        kill_group(group)
    with contextlib.suppress(*_OUT_OF_REACH):
        os.kill(pid, signal.SIGKILL)


def group_of(pid: int) -> int | None:
    """The process group of a process, None if there is no such process."""
    try:
        return os.getpgid(pid)
    except ProcessLookupError:
        return None


def group_exists(group: int) -> bool:
    """Whether a process group has members, those not reaped yet included."""
    with contextlib.suppress(PermissionError):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return False
    return True
