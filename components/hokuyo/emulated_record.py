"""The scans that an emulated sensor has sent: for comparing with what a driver made of them."""

from __future__ import annotations

import json
from dataclasses import dataclass

from cairn.components.hokuyo.emulated_asked import Asked
from cairn.components.hokuyo.emulated_scene import NO_ECHO, Values


@dataclass(frozen=True)
class SentScan:
    """A scan as it was sent, before any fault of the line.

    `time_ms`: the sensor's clock at step 0 [ms]. `distances` [mm or code] and `intensities` (where
    they were asked for): shape (values, 3), `NO_ECHO` where there is none; without `multi_echo`
    the first column alone was sent. In two characters no more than 4095 mm go.
    """

    asked: Asked
    turn: int
    time_ms: int
    distances: Values
    intensities: Values | None

    def line(self) -> str:
        """As a line of JSON: a number for each value, or its echoes where all were asked for."""
        return json.dumps(
            {
                "command": self.asked.letters,
                "first": self.asked.first,
                "last": self.asked.last,
                "cluster": self.asked.cluster,
                "turn": self.turn,
                "time_ms": self.time_ms,
                "distances": self._shown(self.distances),
                "intensities": None if self.intensities is None else self._shown(self.intensities),
            },
            separators=(",", ":"),
        )

    def _shown(self, values: Values) -> list[int] | list[list[int]]:
        if not self.asked.multi_echo:
            first: list[int] = values[:, 0].tolist()
            return first
        return [[one for one in row if one != NO_ECHO] for row in values.tolist()]
