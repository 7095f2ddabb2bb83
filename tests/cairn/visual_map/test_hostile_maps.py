"""Maps with code in their schema, too much content or damaged trees are refused with the reason."""

from tests.hostile_files import HOSTILE
from tests.hostile_reading import MOST_MEMORY_MB, MOST_SECONDS, read_all


def test_hostile_maps_are_refused_with_little_memory_and_time() -> None:
    hostile = HOSTILE["visual_map"]

    outcomes = read_all(f"visual_map/{name}" for name in hostile)

    for name, wanted in hostile.items():
        outcome = outcomes[f"visual_map/{name}"]
        assert outcome.error == "CairnError", (name, outcome)
        assert wanted.reason in outcome.text, (name, outcome)
        assert outcome.seconds < MOST_SECONDS, (name, outcome)
        assert outcome.peak_mb < MOST_MEMORY_MB, (name, outcome)
