"""SCIP 1.1, which the first URG-04LX speaks after power-on: no check sums, statuses of one digit.

Read from what the drivers of Player and of Hokuyo send and expect.
"""

from __future__ import annotations

import numpy as np

from cairn.components.hokuyo.emulated_asked import Asked
from cairn.components.hokuyo.emulated_models import ScipModel
from cairn.components.hokuyo.emulated_scene import Values
from cairn.components.hokuyo.scip_text import BLOCK, encode_numbers

OK, REFUSED, UNKNOWN = "0", "1", "E"

SWITCH = "SCIP2.0"
"""The command after which it speaks SCIP 2, until its power is cut."""


def reply(echo: bytes, status: str, lines: list[bytes] | None = None) -> bytes:
    """A whole reply."""
    return b"\n".join((echo, status.encode(), *(lines or ()), b"", b""))


def version(lines: list[bytes]) -> list[bytes]:
    """The lines of V, from those of VV: without their semicolons and check sums."""
    return [line[:-2] for line in lines]


def asked(parameters: str, model: ScipModel) -> Asked | None:
    """What `G` asks for, first step (3 digits), last (3), cluster (2); None if that cannot be."""
    if len(parameters) != 8 or not (parameters.isascii() and parameters.isdigit()):
        return None
    first, last, cluster = int(parameters[:3]), int(parameters[3:6]), int(parameters[6:])
    if not first <= last <= model.most_step:
        return None
    return Asked("GS", first, last, max(1, cluster))


def scan_lines(distances: Values) -> list[bytes]:
    """Distances in two characters each, in lines of 64."""
    text = encode_numbers(np.clip(distances[:, 0], 0, 4095), 2)
    return [text[at : at + BLOCK] for at in range(0, len(text), BLOCK)]
