"""What Zenoh's channels receive, for the threads that read them."""

from collections.abc import Iterator
from typing import Any

import zenoh


def arriving(channel: Any) -> Iterator[Any]:
    """Yield each sample or query of a channel, until what fills it is undeclared."""
    while True:
        try:
            yield channel.recv()
        except zenoh.ZError:
            return
