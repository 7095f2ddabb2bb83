"""When the messages of a bag are of: by their own stamps, if these are of the bag's clock."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cairn import SECOND

# Stamps that are further from the time of receipt than this are of another clock [ns].
_ANOTHER_CLOCK = 60 * SECOND


def own_stamps(topic: str, received: Sequence[tuple[int, Any]]) -> tuple[list[int], str]:
    """The stamps [ns] that the messages of a topic bear, or if these are of another clock the times
    when they were got; a remark if so, else "".

    `received` are the times of receipt [ns] and the stamps (builtin_interfaces/Time).
    """
    if not received:
        return [], ""
    stamps = [stamp.sec * SECOND + stamp.nanosec for _, stamp in received]
    apart = sorted(abs(stamp - got) for (got, _), stamp in zip(received, stamps, strict=True))
    if apart[len(apart) // 2] <= _ANOTHER_CLOCK:
        return stamps, ""
    return [got for got, _ in received], (
        f"stamps on {topic} are of another clock than the bag's (the first is "
        f"{stamps[0] / SECOND:g} s): the times of receipt are taken instead"
    )
