"""What host and PBS-03JN say to each other: the payloads of frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cairn.components.pbs.frames import crc16

RAYS = 121
BAUD = 57600
"""Speed of its line [bit/s]: seven data bits, no parity."""

LINK_S = 3.0
"""The sensor holds the link for so long after it was asked for [s]."""

LINK_CODE = b"\xa0\x69"
LINK = b"\xa0\x5a"
DISTANCES = b"\xa2\x69"

_CODE_LENGTH = 8


def link_request(code: bytes, *, on: bool = True) -> bytes:
    """Asks for the link, or its end, by the checksum of the link code."""
    return LINK + bytes([on]) + crc16(code).to_bytes(2, "little")


def link_code(payload: bytes) -> bytes | None:
    """The link code, if a payload is one."""
    is_code = payload[:2] == LINK_CODE and len(payload) == 2 + _CODE_LENGTH
    return payload[2:] if is_code else None


def linked(payload: bytes) -> bool | None:
    """Whether the link holds, if a payload says so."""
    return payload[2] == 1 if payload[:2] == LINK and len(payload) == 3 else None


def distances(payload: bytes) -> NDArray[np.int32] | None:
    """The distances [mm] of all rays, from right to left, if a payload holds them."""
    if payload[:2] != DISTANCES or len(payload) != 2 + 2 * RAYS:
        return None
    return np.frombuffer(payload, "<u2", offset=2).astype(np.int32)
