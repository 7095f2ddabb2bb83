"""Processes that a command computes with."""

from __future__ import annotations

import os
import signal
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from cairn.supervision.linux import set_parent_death_signal


def worker_pool(count: int) -> ProcessPoolExecutor:
    """So many processes of their own memory, which end with this one, even if it is killed.

    To be used from the main thread: the kernel ends them with the thread that began them.
    """
    return ProcessPoolExecutor(
        count,
        mp_context=get_context("spawn"),
        initializer=_end_with,
        initargs=(os.getpid(),),
    )


def _end_with(parent: int) -> None:
    set_parent_death_signal(signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)
