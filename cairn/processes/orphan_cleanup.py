"""Makes sure that no process outlives its owner: death signals, process groups, marked trees.

The zygote kills the process group of a component that has ended, and orphans that it inherits as
child subreaper. When the zygote itself is gone, the root kills what carries the tree's mark. If
root and zygote are killed at the same moment, the kernel kills the components; their helper
processes survive.
"""

import contextlib
import ctypes
import os
import signal
import time

import psutil

MARK = "CAIRN_TREE"
"""Environment variable that all processes of a tree are executed with; its value is the tree's."""

_PR_SET_PDEATHSIG = 1
_PR_SET_CHILD_SUBREAPER = 36
_OUT_OF_REACH = (ProcessLookupError, PermissionError)  # ended, or another user's by setuid

_libc = ctypes.CDLL(None, use_errno=True)


def set_parent_death_signal(number: int) -> None:
    """Have the kernel send this signal to the calling process when its parent ends; 0: none.

    It survives `exec` and is not inherited over `fork` (prctl(2), PR_SET_PDEATHSIG). A parent that
    ended before the call goes unnoticed: compare `os.getppid()` afterwards. Raises `OSError`.
    """
    _prctl(_PR_SET_PDEATHSIG, number)


def become_subreaper() -> None:
    """Make orphaned descendants children of the calling process, not of init. Raises `OSError`."""
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)


def ended_child() -> int | None:
    """Return the id of a child that has ended and is not reaped yet, None if there is none."""
    try:
        found = os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return None
    return None if found is None else found.si_pid


def group_exists(group: int) -> bool:
    """Return whether a process group has members, including those not reaped yet."""
    with contextlib.suppress(PermissionError):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return False
    return True


def kill_group(group: int) -> None:
    """Kill all processes of a group; no effect if it has none."""
    with contextlib.suppress(*_OUT_OF_REACH):
        os.killpg(group, signal.SIGKILL)


def kill_orphans(running: set[int]) -> None:
    """Kill the caller's children that are neither `running` nor in the group of one of these."""
    for child in psutil.Process().children():
        group = _group_of(child.pid)
        if child.pid not in running and group not in running:
            _kill(child.pid, group)


def kill_descendants(limit_s: float) -> list[int]:
    """Kill and reap all descendants of the calling process, which must be a child subreaper.

    Returns the ids of processes that did not end within `limit_s` seconds.
    """
    deadline = time.monotonic() + limit_s
    while children := psutil.Process().children():
        for child in children:
            _kill(child.pid, _group_of(child.pid))
        if time.monotonic() > deadline:
            return [child.pid for child in children]
        psutil.wait_procs(children, timeout=0.1)  # then their orphans are children, too
    return []


def kill_marked(mark: str, limit_s: float) -> list[int]:
    """Kill all processes with this mark; return those that had not ended after `limit_s` s."""
    deadline = time.monotonic() + limit_s
    while (left := _marked(mark)) and time.monotonic() < deadline:
        for process in left:
            with contextlib.suppress(psutil.NoSuchProcess, psutil.AccessDenied):
                process.kill()
        psutil.wait_procs(left, timeout=0.1)  # it waits for zombies, too; `_marked` skips them
    return [process.pid for process in left]


def _marked(mark: str) -> list[psutil.Process]:
    """Return all processes that were executed with this mark in their environment."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.NoSuchProcess, psutil.AccessDenied):
            if process.environ().get(MARK) == mark and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found


def _kill(pid: int, group: int | None) -> None:
    """Kill a process and its group, but not the caller's own group."""
    if group is not None and group != os.getpgrp():
        kill_group(group)
    with contextlib.suppress(*_OUT_OF_REACH):
        os.kill(pid, signal.SIGKILL)


def _group_of(pid: int) -> int | None:
    try:
        return os.getpgid(pid)
    except ProcessLookupError:
        return None


def _prctl(option: int, value: int) -> None:
    if _libc.prctl(option, ctypes.c_ulong(value), 0, 0, 0) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"prctl({option}): {os.strerror(number)}")
