"""Runs in lockstep with the same seed are identical to the last bit."""

import subprocess
from pathlib import Path

import pytest

from cairn.testing.launching import CAIRN
from tests.disk import open_to_others
from tests.navigation.driving import DEPLOY, SIM
from tests.patience import LIMIT_S

pytestmark = pytest.mark.slow


TOUR = DEPLOY / "demo_tour.yaml"
MISSION = "mission=[[6.5, 1.8, 0.8], [7.1, 3.5, 1.6]]"  # until a person walks, after 20 s


@pytest.mark.accuracy
def test_two_processes_give_bitwise_equal_runs(tmp_path: Path) -> None:
    up = [CAIRN, "up", str(SIM), "--overlay", str(TOUR), "--set", MISSION, "--lockstep"]
    for folder in ("one", "other"):
        where = ["--report", str(tmp_path / folder)]
        done = subprocess.run(
            [*up, *where], capture_output=True, text=True, timeout=LIMIT_S, umask=0
        )
        assert done.returncode == 0, done

        assert open_to_others(tmp_path / folder) == []

    equal = ("pose.json", "map.pgm", "report.json", "world.jsonl", "trajectory.tum", "truth.tum")
    for name in equal:
        one, other = (tmp_path / folder / name for folder in ("one", "other"))
        assert one.read_bytes() == other.read_bytes(), name
