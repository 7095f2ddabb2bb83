"""What a process does before it compiles a kernel, for example have another process compile it.

`cairn.planar.compiled` makes the calls; the zygote, the root and the commands set them. It is here
because neither knows the other.
"""

import os
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

COMPILATION_LIMIT_S: Final = 600.0
"""Limit for compiling all kernels [s]: they took 168 s on two cores with a load of 20."""

_MOST_COMPILERS = 4  # each needs about 200 MiB

_calls: list[Callable[[], None]] = []
_deferrals: list[None] = []
_deferred: dict[str, list[Callable[[], None]]] = {}


def before_compilation(call: Callable[[], None]) -> None:
    """Have `call` made once, before this process compiles a kernel that the cache does not have.

    Afterwards the process looks for the kernel in the cache again.
    """
    _calls[:] = [call]


def prepare_compilation() -> bool:
    """Make the call that was set, unless it has been made; return whether it was made."""
    if not _calls:
        return False
    _calls.pop()()
    return True


def defer_compilation() -> None:
    """Have the kernels of modules that are imported from now on compiled when first called."""
    _deferrals.append(None)


@contextmanager
def deferred_compilation() -> Iterator[None]:
    """Have the kernels of modules that are imported within the context compiled when first called.

    For commands that only describe components and do not run them.
    """
    defer_compilation()
    try:
        yield
    finally:
        _deferrals.pop()


def is_compilation_deferred() -> bool:
    """Return whether kernels are compiled when they are first called."""
    return bool(_deferrals)


def add_deferred(module: str, compile_kernel: Callable[[], None]) -> None:
    """Remember a kernel of this module for `compile_deferred`."""
    _deferred.setdefault(module, []).append(compile_kernel)


def compile_deferred(begin: Callable[[], None] = lambda: None) -> bool:
    """Fill the cache with all kernels that were deferred; return whether that succeeded.

    Each core has a process, which calls `begin` and then takes one module after the other: kernels
    of one module often call each other, and would be compiled by each process that compiles a
    caller. An error is printed to standard error, by the process that has it.
    """
    modules = list(_deferred.values())
    reader, writer = os.pipe()
    os.write(writer, bytes(range(len(modules))))
    os.close(writer)
    count = min(len(os.sched_getaffinity(0)), _MOST_COMPILERS)
    workers = [_fork_compiler(modules, reader, begin) for _ in range(count)]
    os.close(reader)
    statuses = [os.waitpid(worker, 0)[1] for worker in workers]
    return not any(statuses)


def _fork_compiler(
    modules: list[list[Callable[[], None]]], indices: int, begin: Callable[[], None]
) -> int:
    """Start a process that compiles the modules whose indices it reads; return its process id."""
    parent, worker = os.getpid(), os.fork()
    if worker:
        return worker
    try:
        begin()
        if os.getppid() != parent:  # it ended before `begin` could have this process end with it
            os._exit(1)
        while index := os.read(indices, 1):
            for compile_kernel in modules[index[0]]:
                compile_kernel()
        os._exit(0)
    except BaseException:
        traceback.print_exc()
        os._exit(1)
