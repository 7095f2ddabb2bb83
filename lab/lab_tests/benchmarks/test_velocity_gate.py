"""A short part of the gate's benchmark: hostile commands, and obstacles in the way."""

from pathlib import Path

import pytest

from cairn_lab.benchmarks.velocity_gate import KINDS, Kind, hostile_run, stop_times
from tests.sweeps import sampled

LIMIT_MS = 120.0  # one scan period and 20 ms


@pytest.mark.parametrize("kind", KINDS)
def test_hostile_commands_do_not_drive_the_robot_into_an_obstacle(
    tmp_path: Path, kind: Kind
) -> None:
    run = hostile_run(tmp_path, kind, 1, 8.0)
    assert run.collisions == 0
    assert run.obstacles > 0
    assert run.way_m > 0.5
    assert (run.forged > 0) == (kind == "forged")


@pytest.mark.parametrize("kind", sampled(KINDS))
def test_late_odometry_does_not_drive_the_robot_into_an_obstacle(
    tmp_path: Path, kind: Kind
) -> None:
    base = "components.base.parameters"
    late = f"{base}.odometry_delay_s=0.3", f"{base}.odometry_loss=0.02"
    run = hostile_run(tmp_path, kind, 1, 8.0, *late)
    assert run.collisions == 0
    assert run.obstacles > 0
    assert run.way_m > 0.5


def test_the_same_commands_collide_without_the_check_of_obstacles(tmp_path: Path) -> None:
    unchecked = "components.velocity_gate.parameters.scanner=false"
    assert hostile_run(tmp_path, "forged", 1, 8.0, unchecked).collisions > 0


def test_gate_brakes_within_a_scan_period_for_an_obstacle_in_the_stop_zone(tmp_path: Path) -> None:
    times = stop_times(tmp_path, 0)
    assert times is not None
    assert 0.0 < times.from_appearance <= LIMIT_MS
    assert 0.0 < times.from_scan <= LIMIT_MS
    assert times.gap_m > 0.0
