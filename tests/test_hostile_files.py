"""Hostile files are refused with the reason, with little memory and time: two of each kind.

`make attack` reads all of them.
"""

import re

from tests.hostile_files import HOSTILE
from tests.hostile_reading import MOST_MEMORY_MB, MOST_SECONDS, read_all


def test_hostile_files_are_refused_with_little_memory_and_time() -> None:
    chosen = {
        f"{kind}/{name}": files[name]
        for kind, files in HOSTILE.items()
        for name in [*files][:: len(files) - 1]
    }

    outcomes = read_all(chosen)

    for name, wanted in chosen.items():
        outcome = outcomes[name]
        assert outcome.error == "CairnError", (name, outcome)
        assert re.search(wanted.reason, outcome.text), (name, outcome)
        assert outcome.seconds < MOST_SECONDS, (name, outcome)
        assert outcome.peak_mb < MOST_MEMORY_MB, (name, outcome)
