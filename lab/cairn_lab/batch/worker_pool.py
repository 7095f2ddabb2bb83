"""Processes that share the runs of an evaluation or an experiment."""

import os
import signal
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from cairn.processes.orphan_cleanup import set_parent_death_signal


def worker_pool(count: int) -> ProcessPoolExecutor:
    """Return a pool of `count` processes, which end with this one, even if it is killed.

    Call it on the main thread: the kernel kills them when the thread that started them ends.
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
