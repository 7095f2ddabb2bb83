"""Signals that a part of the program handles itself."""

import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def signal_handlers(
    numbers: Iterable[int], handler: Callable[[int, Any], Any] | signal.Handlers
) -> Iterator[None]:
    """Have `handler` called for signals within the context; in the main thread only."""
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)
