"""Hostile maps and recordings are refused with the reason, with little memory and time.

`make attack` reads the files of all kinds.
"""

import re

import pytest

from tests.hostile_files import HOSTILE
from tests.hostile_reading import MOST_MEMORY_MB, MOST_SECONDS, read_all


@pytest.mark.parametrize("kind", ["visual_map", "graph", "recording", "mcap", "zones"])
def test_hostile_files_are_refused_with_little_memory_and_time(kind: str) -> None:
    hostile = HOSTILE[kind]

    outcomes = read_all(f"{kind}/{name}" for name in hostile)

    for name, wanted in hostile.items():
        outcome = outcomes[f"{kind}/{name}"]
        assert outcome.error == "CairnError", (name, outcome)
        assert re.search(wanted.reason, outcome.text), (name, outcome)
        assert outcome.seconds < MOST_SECONDS, (name, outcome)
        assert outcome.peak_mb < MOST_MEMORY_MB, (name, outcome)
