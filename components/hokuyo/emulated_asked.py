"""Reads the commands that ask an emulated sensor to measure, as strictly as a real one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cairn.components.hokuyo.emulated_models import ScipModel
from cairn.components.hokuyo.emulated_scene import Turn, Values

MEASURING = frozenset(family + kind for family in "GHMN" for kind in "DES") - {"HS", "NS"}
"""All commands that ask to measure, of whichever models."""


@dataclass(frozen=True)
class Asked:
    """A command of the families G, H, M, N: which steps, in which clusters, how often."""

    letters: str
    first: int
    last: int
    cluster: int
    interval: int = 0
    scans: int = 0
    """How many; 0: without end, or, for a single scan, one."""

    @property
    def is_stream(self) -> bool:
        """Whether scans are sent as they are measured."""
        return self.letters[0] in "MN"

    @property
    def multi_echo(self) -> bool:
        """Whether all echoes of a step are asked for."""
        return self.letters[0] in "HN"

    @property
    def intensity(self) -> bool:
        """Whether intensities are asked for."""
        return self.letters[1] == "E"

    @property
    def width(self) -> int:
        """Characters of a number."""
        return 2 if self.letters[1] == "S" else 3

    def of(self, turn: Turn, model: ScipModel) -> tuple[Values, Values]:
        """Of all that a turn has measured, what is asked for: distances, intensities.

        Of a cluster that is the step with the smallest distance, among those that are valid.
        """
        distances = turn.distances[self.first : self.last + 1]
        intensities = turn.intensities[self.first : self.last + 1]
        if self.cluster == 1:
            return distances, intensities
        nearest = distances[:, 0]
        ranked = np.where(nearest >= model.least_mm, nearest, np.iinfo(np.int32).max)
        groups = -(-ranked.size // self.cluster)
        padded = np.full(groups * self.cluster, np.iinfo(np.int32).max, np.int64)
        padded[: ranked.size] = ranked
        chosen = padded.reshape(groups, self.cluster).argmin(axis=1)
        at = chosen + self.cluster * np.arange(groups)
        return distances[at], intensities[at]


def asked(letters: str, parameters: str, model: ScipModel) -> Asked | str:
    """What is asked for, or the status with which it is refused."""
    stream = letters[0] in "MN"
    lengths = (4, 4, 2, 1, 2) if stream else (4, 4, 2)
    if len(parameters) < sum(lengths):
        return "0C"
    if len(parameters) > sum(lengths):
        return "0D"
    values = []
    at = 0
    for length, status in zip(lengths, ("01", "02", "03", "06", "07"), strict=False):
        text = parameters[at : at + length]
        if not (text.isascii() and text.isdigit()):
            return status
        values.append(int(text))
        at += length
    first, last, cluster, *more = values
    if last > model.most_step:
        return "04"
    if last < first:
        return "05"
    return Asked(letters, first, last, max(1, cluster), *more)
