"""The plots of `cairn topic plot`: numbers over time, sequences over their indices."""

from __future__ import annotations

import math
import shutil
import sys
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from cairn.client import NoMessageError, Subscription
from cairn.schemas.message import InvalidMessage
from cairn.terminal.fields import FieldPath
from cairn.terminal.output import line

_PICTURES_HZ = 4.0
_MAX_POINTS = 20_000  # kept of each field
_MAX_DRAWN = 1_000  # of these: more than any terminal has columns
_LEAST_SIZE = (20, 8)  # columns and lines


class _FieldSeries:
    """The last values of some fields, with their times of arrival."""

    def __init__(self, paths: Sequence[FieldPath], seconds: float) -> None:
        self._paths = paths
        self._seconds = seconds
        self._times: deque[float] = deque(maxlen=_MAX_POINTS)
        self._values: list[deque[Any]] = [deque(maxlen=_MAX_POINTS) for _ in paths]
        self.count = 0

    def add(self, message: Any) -> None:
        """Add the values of a message that has arrived now."""
        self.count += 1
        now = time.monotonic()
        self._times.append(now)
        for path, values in zip(self._paths, self._values, strict=True):
            value = path.value(message)
            values.append(value if not path.is_sequence else [float(one) for one in value])
        while self._times[0] < now - self._seconds or (
            # Only the newest message is drawn over indices.
            self._paths[0].is_sequence and len(self._times) > 1
        ):
            self._times.popleft()
            for values in self._values:
                values.popleft()

    def curves(self) -> list[tuple[str, list[float], list[float]]]:
        """Return the label, the abscissas and the ordinates of each curve, for what is finite."""
        found = []
        newest = self._times[-1]
        for path, values in zip(self._paths, self._values, strict=True):
            if path.is_sequence:
                ys = values[-1] if values else []
                xs = [float(index) for index in range(len(ys))]
            else:
                xs = [at - newest for at in self._times]
                ys = [math.nan if value is None else float(value) for value in values]
            stride = max(1, math.ceil(len(xs) / _MAX_DRAWN))
            points = [
                (x, y) for x, y in zip(xs[::stride], ys[::stride], strict=True) if math.isfinite(y)
            ]
            found.append((path.text, [x for x, _ in points], [y for _, y in points]))
        return found

    @property
    def abscissa(self) -> str:
        """What the horizontal axis means."""
        return "index" if self._paths[0].is_sequence else "s"


def plot_topic(
    messages: Subscription[Any], first: Any, paths: Sequence[FieldPath], seconds: float
) -> None:
    """Plot fields live on a terminal until q or Ctrl-C; else print one plot after `seconds`."""
    series = _FieldSeries(paths, seconds)
    series.add(first)
    if not sys.stdout.isatty():
        _receive(messages, series, time.monotonic() + seconds)
        size = shutil.get_terminal_size((80, 24))
        line(_drawn(series, size, colored=False))
        return
    from rich.text import Text

    from cairn.terminal.screen import QUIT_KEYS, screen

    began = time.monotonic()
    with suppress(KeyboardInterrupt), screen() as shown:
        while shown.key(0.0) not in QUIT_KEYS:
            _receive(messages, series, time.monotonic() + 1.0 / _PICTURES_HZ)
            columns, lines = shown.size
            rate = series.count / max(1.0, time.monotonic() - began)
            head = f"{messages.topic}   {rate:.1f} messages per second   q ends"
            picture = Text.from_ansi(_drawn(series, (columns, lines - 1), colored=True))
            shown.draw(Text(f"{head[:columns]}\n").append_text(picture))


def _receive(messages: Subscription[Any], series: _FieldSeries, until: float) -> None:
    while (left_s := until - time.monotonic()) > 0:
        try:
            series.add(messages.next(left_s))
        except NoMessageError:
            return
        except InvalidMessage:
            continue  # `cairn topic echo` prints why


def _drawn(series: _FieldSeries, size: tuple[int, int], *, colored: bool) -> str:
    import plotext  # takes 0.4 s

    columns, lines = (max(pair) for pair in zip(size, _LEAST_SIZE, strict=True))
    figure: Any = plotext.figure
    figure.clear()
    figure.theme("simple" if colored else "colorless")
    figure.plot_size(columns, lines)
    for label, xs, ys in series.curves():
        if xs:
            signal = figure.signal(xs, ys, marker="braille")
            signal.label(label)
            signal.lines()
            figure.draw(signal)
    figure.label(series.abscissa, "x")
    text = str(figure.build())
    return text if colored else str(plotext.uncolorize(text))
