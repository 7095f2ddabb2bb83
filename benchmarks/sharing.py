"""Robots that share what they find out about landmarks: equal maps, and how soon."""

import tempfile
import time
from pathlib import Path

from benchmarks.result import Metric
from tests.components.map_builder.test_shared_landmarks import history
from tests.navigation.test_fleet import repair_maps_of_five_robots

HISTORIES = 10_000


def measure() -> list[Metric]:
    """Run random histories of three robots, and a repair in the maps of five."""
    began, unequal = time.process_time(), 0
    for seed in range(HISTORIES):
        try:
            history(seed)
        except AssertionError as error:
            print(error)
            unequal += 1
    took_s = time.process_time() - began
    with tempfile.TemporaryDirectory() as folder:
        repair = repair_maps_of_five_robots(Path(folder))
    note = f"partitions, repeated and reordered messages; {took_s:.0f} s of processor time"
    found_s = repair.first_s - repair.moved_s
    return [
        Metric(
            f"{HISTORIES:,} histories of three robots: unequal maps", unequal, "", 0, None, note
        ),
        Metric("object moved: registered by the robot in front of it after", found_s, "s"),
        Metric(
            "repaired in the maps of all five robots", repair.all_s - repair.first_s, "s later", 5
        ),
    ]
