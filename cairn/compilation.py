"""What a process does before it compiles a kernel, for example have another process compile it.

`cairn.planar.compiled` makes the call; the zygote and the root set it. It is here because neither
knows the other.
"""

from collections.abc import Callable

_calls: list[Callable[[], None]] = []


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
