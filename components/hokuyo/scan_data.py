"""A scan's values out of the text of its reply. Section "Data encoding", and multi-echo models."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.hokuyo.replies import Reply
from cairn.components.hokuyo.requests import ScanRequest
from cairn.components.hokuyo.scip_text import (
    BLOCK,
    ScipError,
    checked,
    decode_number,
    decode_numbers,
)

_FULL = BLOCK + 2  # a full line: its data, its check sum, its line feed
_AND = ord("&")  # stands before each echo of a step but the first
_MOST_ECHOES = 3
NO_ECHO = -1
"""In place of an echo that a step does not have."""


@dataclass(frozen=True)
class ScanData:
    """What a sensor has measured in one turn, as it was sent.

    `time_ms`: the sensor's clock, of 24 bits, at step 0 [ms]; SCIP 1.1 has none. `distances` [mm;
    or a code of what failed]: shape (values, echoes), `NO_ECHO` where there is none; one echo
    unless several were asked for. `intensities` [no unit]: the same shape, if they were asked for.
    """

    time_ms: int | None
    distances: NDArray[np.int32]
    intensities: NDArray[np.int32] | None = None


def scan_data(reply: Reply, request: ScanRequest) -> ScanData:
    """The scan in a reply of status 99 to the request.

    Raises `ScipError` if a check sum is wrong, or anything but just what was asked for came: bytes
    that got lost or were added must not shift one beam's range to another.
    """
    stamp, _, body = reply.body.partition(b"\n")
    time_ms = decode_number(checked(stamp))
    if len(stamp) != 5:
        raise ScipError(f"the time {stamp!r} is not of four characters")
    text = _joined(body)
    width = 2 if request.command.startswith(b"MS") else 3
    if request.multi_echo:
        numbers, step, echo = _echoes(text, 2 * width if request.intensity else width)
        steps = int(step[-1]) + 1 if step.size else 0
    else:
        numbers, step, echo = text, None, None
        steps, rest = divmod(text.size, 2 * width if request.intensity else width)
        if rest:
            raise ScipError(f"{text.size} characters are no whole number of values")
    values = decode_numbers(numbers, width).reshape(-1, 2 if request.intensity else 1)
    if steps != request.values:
        raise ScipError(f"{steps} values came, but {request.values} were asked for")
    columns = [_spread(values[:, one], step, echo, steps) for one in range(values.shape[1])]
    return ScanData(time_ms, columns[0], columns[1] if request.intensity else None)


def _joined(body: bytes) -> NDArray[np.uint8]:
    """The data of all lines in one, their check sums verified."""
    full, rest = divmod(len(body) + 1, _FULL)  # the last line feed went with the reply's end
    data = np.frombuffer(body + b"\n", np.uint8)
    lines = data[: full * _FULL].reshape(-1, _FULL)
    if np.any(lines[:, -1] != 10):
        raise ScipError("a line of data is not of 64 characters")
    sums = (lines[:, :BLOCK].sum(axis=1) & 0x3F) + 0x30
    if np.any(sums != lines[:, BLOCK]):
        raise ScipError("the check sum of a line of data is wrong")
    text = lines[:, :BLOCK].reshape(-1)
    if rest == 0:
        return text
    last = checked(body[full * _FULL :])
    return np.concatenate((text, np.frombuffer(last, np.uint8)))


def _echoes(
    text: NDArray[np.uint8], width: int
) -> tuple[NDArray[np.uint8], NDArray[np.intp], NDArray[np.intp]]:
    """Characters without `&`; for each `width` of them which step they are of, and which echo."""
    marks = np.flatnonzero(text == _AND)
    numbers = text[text != _AND]
    before = marks - np.arange(marks.size)  # characters before each mark
    if numbers.size % width or np.any(before % width) or np.any(before >= numbers.size):
        raise ScipError("an echo's mark stands within a value")
    further = np.zeros(numbers.size // width, bool)
    further[before // width] = True
    if np.count_nonzero(further) != marks.size or (further.size and further[0]):
        raise ScipError("an echo's mark stands where there is no echo")
    step = np.cumsum(~further) - 1
    firsts = np.flatnonzero(~further)
    echo = np.arange(further.size) - firsts[step] if step.size else step
    if echo.size and int(echo.max()) >= _MOST_ECHOES:
        raise ScipError(f"a step has more than {_MOST_ECHOES} echoes")
    return numbers, step, echo


def _spread(
    values: NDArray[np.int32],
    step: NDArray[np.intp] | None,
    echo: NDArray[np.intp] | None,
    steps: int,
) -> NDArray[np.int32]:
    if step is None or echo is None:
        return values.reshape(-1, 1)
    table = np.full((steps, _MOST_ECHOES), NO_ECHO, np.int32)
    table[step, echo] = values
    return table
