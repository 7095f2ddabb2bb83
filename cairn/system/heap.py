"""The heap of this process: that of glibc, which Zenoh, NumPy and large Python objects use."""

import ctypes
import os
import sys
from contextlib import suppress

TUNABLES = "GLIBC_TUNABLES"
SMALL_THREAD_CACHES = "glibc.malloc.tcache_max=256"
"""Value of `TUNABLES`: each thread caches only freed blocks of up to 256 bytes.

glibc's default is 1,032 bytes, up to 236 kB for each of the 30 to 60 threads of a process: a part
of the growth of its memory in the first hour (lab/history.md).
"""

_RESTARTED = "CAIRN_RESTARTED_WITH_TUNABLES"
"""Set for the restart: a privileged program loses `TUNABLES`, and would restart for ever."""

_ARENAS = "MALLOC_ARENA_MAX"
_M_ARENA_MAX = -8  # malloc.h

_libc = ctypes.CDLL(None)


def share_heap() -> None:
    """Have all threads use one heap; call it before the first thread starts.

    With a heap for each thread, what lives long lies scattered among what is freed soon, and keeps
    its pages: the router of a deployment grew by 16 kB with each restart of a component instead
    of 4 kB (lab/history.md). `MALLOC_ARENA_MAX` in the environment overrides it.
    """
    if _ARENAS not in os.environ and hasattr(_libc, "mallopt"):  # another C library has no heaps
        _libc.mallopt(_M_ARENA_MAX, 1)


def restart_with_small_thread_caches() -> None:
    """Execute this program again with `SMALL_THREAD_CACHES`, unless `TUNABLES` are set already.

    glibc reads them only when a program starts. Call it first: what was opened or started is lost.
    """
    is_glibc = hasattr(_libc, "gnu_get_libc_version")
    if not is_glibc or TUNABLES in os.environ or _RESTARTED in os.environ:
        return
    environment = os.environ | {TUNABLES: SMALL_THREAD_CACHES, _RESTARTED: "1"}
    with suppress(OSError):  # it runs without as well
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], environment)


def return_free_memory() -> None:
    """Return the free pages of the heap to the system, such as those of a burst of messages.

    By itself, glibc returns only what is free at the end of the heap, and keeps up to 32 MiB there
    in the processes of components (`cairn.processes.launcher`).
    """
    if hasattr(_libc, "malloc_trim"):
        _libc.malloc_trim(ctypes.c_size_t(0))
