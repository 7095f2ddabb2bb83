"""The plan of a campaign's faults: a pure function of the campaign and its seed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from random import Random

from cairn_lab.campaign.model import Campaign

_LONGEST_INTERVAL = 4.0  # of the mean


@dataclass(frozen=True)
class PlannedFault:
    """A fault that is due at a time [s] since the campaign began.

    `entry` is the index in the campaign's `faults`. Its target and all else that is random about
    it are drawn by `seed`.
    """

    number: int
    at_s: float
    entry: int
    kind: str
    seed: int


def planned_faults(campaign: Campaign) -> Iterator[PlannedFault]:
    """Yield the faults in order of time, until the campaign's end."""
    random = Random(campaign.seed)
    weights = [fault.weight for fault in campaign.faults]
    most = math.inf if campaign.count is None else campaign.count
    end_s = math.inf if campaign.duration_s is None else campaign.duration_s
    at_s, number = campaign.settle_s, 0
    while number < most:
        wait_s = random.expovariate(1.0 / campaign.interval_s)
        at_s += min(wait_s, _LONGEST_INTERVAL * campaign.interval_s)
        if at_s > end_s - campaign.settle_s:
            return
        number += 1
        (entry,) = random.choices(range(len(weights)), weights)
        kind = campaign.faults[entry].kind
        yield PlannedFault(number, round(at_s, 3), entry, kind, random.getrandbits(32))
