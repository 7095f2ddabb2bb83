"""What a process does before it compiles a kernel, for example have another process compile it.

`cairn.planar.compiled` makes the calls; the zygote, the root and the commands set them. It is here
because neither knows the other.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

_calls: list[Callable[[], None]] = []
_on_compiled: list[Callable[[str], None]] = []
_deferrals: list[None] = []


def before_compilation(
    call: Callable[[], None], on_compiled: Callable[[str], None] | None = None
) -> None:
    """Have `call` made once, before this process compiles a kernel that the cache does not have.

    Afterwards the process looks for the kernel in the cache again. `on_compiled` is called with the
    name of each kernel that this process has compiled.
    """
    _calls[:] = [call]
    _on_compiled[:] = [on_compiled] if on_compiled is not None else []


def prepare_compilation() -> bool:
    """Make the call that was set, unless it has been made; return whether it was made."""
    if not _calls:
        return False
    _calls.pop()()
    return True


def report_compiled(kernel: str) -> None:
    """Report that this process has compiled a kernel, which is in the cache now."""
    for call in _on_compiled:
        call(kernel)


@contextmanager
def deferred_compilation() -> Iterator[None]:
    """Have the kernels of modules that are imported within the context compiled when first called.

    For commands that only describe components and do not run them.
    """
    _deferrals.append(None)
    try:
        yield
    finally:
        _deferrals.pop()


def is_compilation_deferred() -> bool:
    """Return whether kernels are compiled when they are first called."""
    return bool(_deferrals)
