"""The heap of this process: that of glibc, which Zenoh, NumPy and large Python objects use."""

import ctypes
import os

_ARENAS = "MALLOC_ARENA_MAX"
_M_ARENA_MAX = -8  # malloc.h

_libc = ctypes.CDLL(None)


def share_heap() -> None:
    """Have all threads use one heap; call it before the first thread starts.

    With a heap for each thread, what lives long lies scattered among what is freed soon, and keeps
    its pages: the router of a deployment grew by 16 kB with each restart of a component instead
    of 4 kB (docs/benchmarks.md). `MALLOC_ARENA_MAX` in the environment overrides it.
    """
    if _ARENAS not in os.environ and hasattr(_libc, "mallopt"):  # another C library has no heaps
        _libc.mallopt(_M_ARENA_MAX, 1)


def return_free_memory() -> None:
    """Return the free pages of the heap to the system, such as those of a burst of messages.

    By itself, glibc returns only what is free at the end of the heap, and keeps up to 32 MiB there
    in the processes of components (`cairn.supervision.zygote_client`).
    """
    if hasattr(_libc, "malloc_trim"):
        _libc.malloc_trim(ctypes.c_size_t(0))
