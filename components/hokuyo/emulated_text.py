"""Writes what SCIP 2 sensors answer: statuses, lines of facts, scans."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from cairn.components.hokuyo.emulated_record import SentScan
from cairn.components.hokuyo.emulated_scene import NO_ECHO
from cairn.components.hokuyo.scip_text import (
    BLOCK,
    check_sum,
    encode_number,
    encode_numbers,
    with_sum,
)

_AND = ord("&")  # stands before each echo of a step but the first


def reply(echo: bytes, status: str, lines: Iterable[bytes] = ()) -> bytes:
    """A whole reply: the command's echo, its status, further lines, an empty line."""
    return b"\n".join((echo, with_sum(status.encode()), *lines, b"", b""))


def fact(key: str, value: str, *, arrow_summed: bool = True) -> bytes:
    """A line of VV, PP or II; its semicolon is not summed up."""
    text = f"{key}:{value}".encode()
    summed = text if arrow_summed else text.partition(b"<-")[0]
    return text + b";" + check_sum(summed)


def scan_reply(echo: bytes, status: str, scan: SentScan) -> bytes:
    """A whole reply with a scan: the time stamp's line, then values in lines of 64 characters.

    A number that does not go into its characters is sent as the largest one that does.
    """
    stamp = with_sum(encode_number(scan.time_ms, 4))
    return reply(echo, status, (stamp, _blocks(_scan_text(scan))))


def _scan_text(scan: SentScan) -> NDArray[np.uint8]:
    width = scan.asked.width
    parts = [scan.distances] if scan.intensities is None else [scan.distances, scan.intensities]
    shown = scan.distances if scan.asked.multi_echo else scan.distances[:, :1]
    count, echoes = shown.shape
    most = (1 << 6 * width) - 1
    cells = np.empty((count, echoes, 1 + width * len(parts)), np.uint8)
    cells[..., 0] = _AND
    for place, values in enumerate(parts):
        numbers = np.clip(values[:, :echoes], 0, most).reshape(-1)
        text = np.frombuffer(encode_numbers(numbers, width), np.uint8)
        cells[..., 1 + width * place : 1 + width * (place + 1)] = text.reshape(count, echoes, width)
    sent = np.repeat((shown != NO_ECHO)[..., None], cells.shape[2], axis=2)
    sent[:, 0, 0] = False  # no mark before a first echo
    chosen: NDArray[np.uint8] = cells[sent]
    return chosen


def _blocks(text: NDArray[np.uint8]) -> bytes:
    full, rest = divmod(text.size, BLOCK)
    lines = np.full((full, BLOCK + 2), ord("\n"), np.uint8)
    lines[:, :BLOCK] = text[: full * BLOCK].reshape(full, BLOCK)
    lines[:, BLOCK] = (lines[:, :BLOCK].sum(axis=1) & 0x3F) + 0x30
    last = with_sum(text[full * BLOCK :].tobytes()) + b"\n" if rest else b""
    return (lines.tobytes() + last)[:-1]
