"""A live display that fills a terminal and reads keys: for plots and maps."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

_ARROWS = {b"\x1b[A": "up", b"\x1b[B": "down", b"\x1b[C": "right", b"\x1b[D": "left"}
_SEQUENCE_S = 0.05  # an escape sequence arrives within this time, also over SSH
QUIT_KEYS = frozenset({"q", "Q", "\x1b", "\x04"})
"""q, Escape, Ctrl-D."""


class Screen:
    """A picture on a terminal, replaced again and again, and the keys that are pressed."""

    def __init__(self, console: Console, draw: Callable[[RenderableType], None]) -> None:
        self._draw = draw
        self._console = console
        self.has_keys = sys.stdin.isatty()

    @property
    def size(self) -> tuple[int, int]:
        """Columns and lines of the terminal, now."""
        return self._console.size.width, self._console.size.height

    def draw(self, picture: RenderableType) -> None:
        """Replace the picture."""
        self._draw(picture)

    def key(self, timeout_s: float) -> str:
        """Return the next key that is pressed within a time [s]; "" if none is.

        Arrows are `up`, `down`, `left`, `right`. Without a terminal for input it waits.
        """
        streams = [sys.stdin] if self.has_keys else []
        ready, _, _ = select.select(streams, [], [], max(0.0, timeout_s))
        if not ready:
            return ""
        pressed = os.read(sys.stdin.fileno(), 1)
        if not pressed:  # the terminal was closed
            return "q"
        if pressed == b"\x1b" and select.select(streams, [], [], _SEQUENCE_S)[0]:
            pressed += os.read(sys.stdin.fileno(), 2)
        return _ARROWS.get(pressed, pressed.decode("utf-8", "replace"))


@contextmanager
def screen() -> Iterator[Screen]:
    """Yield a screen on the terminal, which has its former contents and modes again afterwards."""
    from rich.console import Console  # takes 50 ms
    from rich.live import Live

    console = Console(highlight=False)
    modes = termios.tcgetattr(sys.stdin) if sys.stdin.isatty() else None
    live = Live(console=console, auto_refresh=False, screen=True)
    try:
        if modes is not None:
            tty.setcbreak(sys.stdin)
        with live:
            yield Screen(console, lambda picture: live.update(picture, refresh=True))
    finally:
        if modes is not None:
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, modes)
