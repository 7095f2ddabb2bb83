"""Kills the processes of a tree that are left when its zygote is gone, found by their mark."""

import contextlib
import os
import select
import time

import psutil

MARK = "CAIRN_TREE"  # environment variable, its value the tree's


def remaining(mark: str) -> list[int]:
    """The ids of all processes with this mark in the environment they were executed with."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.NoSuchProcess, psutil.AccessDenied):
            if process.environ().get(MARK) == mark and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process.pid)
    return found


def kill_remaining(mark: str, limit_s: float) -> list[int]:
    """Kill all processes with this mark; gives those that had not ended after `limit_s` seconds."""
    deadline = time.monotonic() + limit_s
    while (pids := remaining(mark)) and time.monotonic() < deadline:
        for pid in pids:
            _kill(pid, deadline)
    return pids


def _kill(pid: int, deadline: float) -> None:
    try:
        process = os.pidfd_open(pid)
    except ProcessLookupError:
        return
    try:
        with contextlib.suppress(psutil.NoSuchProcess, ProcessLookupError):
            psutil.Process(pid).kill()
        poll = select.poll()
        poll.register(process, select.POLLIN)
        poll.poll(max(0.0, deadline - time.monotonic()) * 1000)
    finally:
        os.close(process)
