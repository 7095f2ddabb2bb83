"""Compile numeric kernels with numba when their module is imported, and cache them on disk.

A robot never waits for a compiler: modules are imported before any component's process is forked,
and from the second start on the compiled code is read from the cache. The zygote does not compile
either: at the first start a helper process fills the cache (`cairn.system.kernel_compilation`).
"""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from enum import Enum
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import caching

from cairn.system.kernel_compilation import (
    add_deferred,
    is_compilation_deferred,
    prepare_compilation,
)

# Numba's annotations cover its public interface only.
_caching: Any = caching

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def compiled(*signatures: str, sums_in_any_order: bool = False) -> Callable[[Kernel], Kernel]:
    """Compile a function for these numba signatures: loops over arrays at the speed of C.

    A function without signatures is compiled into its callers. Division by zero gives infinity or
    NaN as in NumPy; indices are not checked. With `sums_in_any_order` the compiler may add several
    elements at a time, which rounds differently but is still deterministic.
    """
    relaxed = {"reassoc", "contract", "nsz", "arcp"} if sums_in_any_order else False

    def decorate(function: Kernel) -> Kernel:
        jit = numba.njit(error_model="numpy", fastmath=relaxed, nogil=bool(signatures))
        kernel: Any = jit(function)
        # What `cache=True` does, but with an index that depends on the callees as well.
        kernel._cache = _KernelCache(function, sums_in_any_order)
        if signatures and is_compilation_deferred():
            _compile_at_first_call(kernel, signatures)
            add_deferred(function.__module__, lambda: _compile(kernel, signatures))
        elif signatures:
            _compile(kernel, signatures)
        return cast("Kernel", kernel)

    return decorate


def _compile(kernel: Any, signatures: Iterable[str]) -> None:
    for signature in signatures:
        kernel.compile(signature)
    kernel.disable_compile()


def _compile_at_first_call(kernel: Any, signatures: Iterable[str]) -> None:
    def compile_for_arguments(*_arguments: Any, **_keywords: Any) -> Any:
        del kernel._compile_for_args  # the class has the method that this one replaces
        _compile(kernel, signatures)
        return kernel

    # What numba calls if it has nothing compiled for arguments of these types; it then calls what
    # this returns.
    kernel._compile_for_args = compile_for_arguments


class _KernelCache(_caching.FunctionCache):  # type: ignore[misc]  # see `_caching`
    """The cached machine code of one kernel, valid as long as its fingerprint stays the same.

    Numba alone compares only the kernel's own file, so that it would load old code after an edit of
    a callee in another file. Numba still chooses the folder: NUMBA_CACHE_DIR, `__pycache__` beside
    the file, or the user's cache folder if the package is read-only. The file names have no line
    number: the code of an edited kernel replaces the old code instead of lying beside it.
    """

    def __init__(self, function: Callable[..., Any], *options: object) -> None:
        super().__init__(function)
        self._options = options
        self._source = Path(function.__code__.co_filename)
        self._bound = False

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled code for a signature, or None if it is not cached or outdated."""
        self._bind()
        code = super().load_overload(sig, target_context)
        if code is None and prepare_compilation():  # which may have filled the cache
            code = super().load_overload(sig, target_context)
        return code

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write the compiled code for a signature to disk."""
        self._bind()
        super().save_overload(sig, data)
        self._remove_orphans()

    def _bind(self) -> None:
        """Open the index; only now, as a callee may be defined below the kernel in its file."""
        if self._bound:
            return
        name = self._py_func.__qualname__.replace("<", "").replace(">", "")
        self._cache_file = _caching.IndexDataCacheFile(
            cache_path=self._cache_path,
            filename_base=f"{self._source.stem}.{name}.{sys.implementation.cache_tag}",
            source_stamp=fingerprint(self._py_func, *self._options),
        )
        self._bound = True

    def _remove_orphans(self) -> None:
        """Remove the code of kernels that the source file no longer has."""
        source = self._source.read_text(encoding="utf-8")
        for path in Path(self._cache_path).glob(f"{self._source.stem}.*.nb[ic]"):
            kernel = re.split(r"\.(?:py\d|cpython|pypy)", path.name)[0].rpartition(".")[2]
            if f"def {kernel}(" not in source:
                path.unlink(missing_ok=True)


def fingerprint(kernel: Callable[..., Any], *options: object) -> str:
    """Hash all that is compiled into a kernel.

    That is its bytecode, the constants that it reads, and the same of all functions that it calls,
    in whatever file these are. A new comment or docstring changes nothing.
    """
    digest = hashlib.sha256(repr(options).encode())
    for part in _parts_of(kernel, set()):
        digest.update(part.encode())
        digest.update(b"\0")
    return digest.hexdigest()


def _parts_of(function: Any, known: set[Any]) -> Iterator[str]:
    """Describe a function and its callees, each once, in a reproducible order."""
    function = getattr(function, "py_func", function)
    if function in known:
        yield f"again {function.__qualname__}"
        return
    known.add(function)
    yield function.__qualname__
    yield repr(function.__defaults__)
    for cell in function.__closure__ or ():
        yield from _value_parts(cell.cell_contents, (), known)
    yield from _code_parts(function.__code__, function.__globals__, known)


def _code_parts(code: CodeType, names: dict[str, Any], known: set[Any]) -> Iterator[str]:
    yield code.co_code.hex()
    yield repr((code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars))
    for number, constant in enumerate(code.co_consts):
        if isinstance(constant, CodeType):
            yield from _code_parts(constant, names, known)
        elif number or not isinstance(constant, str):  # the first one is the docstring
            yield from _value_parts(constant, (), known)
    for name in code.co_names:
        if name in names:
            yield from _value_parts(names[name], code.co_names, known)


def _value_parts(value: Any, names: tuple[str, ...], known: set[Any]) -> Iterator[str]:
    """Describe a value that a kernel reads; of a module, the attributes with these names."""
    if isinstance(value, FunctionType) or hasattr(value, "py_func"):
        yield from _parts_of(value, known)
    elif isinstance(value, ModuleType):
        yield value.__name__
        for name in names:
            if hasattr(value, name) and not isinstance(getattr(value, name), ModuleType):
                yield from _value_parts(getattr(value, name), (), known)
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype.str}{value.shape}"
        yield value.tobytes().hex()
    elif isinstance(value, type) and issubclass(value, Enum):
        yield repr(list(value))
    elif isinstance(value, frozenset | set):
        yield repr(sorted(map(repr, value)))
    elif isinstance(value, tuple):
        for item in value:
            yield from _value_parts(item, (), known)
        yield f"tuple of {len(value)}"
    elif value is None or isinstance(value, int | float | complex | str | bytes | numba.types.Type):
        yield repr(value)
    else:  # a builtin, a NumPy function or a class: known by its name; its address would change
        yield f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', type(value))}"
