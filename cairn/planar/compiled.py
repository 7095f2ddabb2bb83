"""Compiles numeric kernels ahead, when their module is imported, and keeps them on disk.

A robot never waits for a compiler: modules are imported before any component's process is forked,
and from the second time on what was compiled is read from numba's cache.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def compiled(*signatures: str, sums_in_any_order: bool = False) -> Callable[[Kernel], Kernel]:
    """Compile a function for these numba signatures: loops over arrays at the speed of C.

    Without a signature it is compiled into its callers, and cannot be called before them.
    Division by zero gives infinity or NaN as in numpy; indices are not checked. With
    `sums_in_any_order` the compiler may add up several elements at a time, which rounds otherwise,
    but always in the same way.
    """
    relaxed = {"reassoc", "contract", "nsz", "arcp"} if sums_in_any_order else False

    def decorate(function: Kernel) -> Kernel:
        if not signatures:
            inlined = numba.njit(error_model="numpy", fastmath=relaxed, cache=True)
            return cast("Kernel", inlined(function))
        jit = numba.njit(
            list(signatures), error_model="numpy", fastmath=relaxed, cache=True, nogil=True
        )
        return cast("Kernel", jit(function))

    return decorate
