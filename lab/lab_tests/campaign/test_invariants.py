"""Each invariant reports a violation in what it is given, and nothing without one."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import pytest

from cairn.deployment.model import Deployment
from cairn.schemas.cairn_msgs import VisualMapChange
from cairn.schemas.cairn_nav_msgs import Collision, NavigationStatus, VelocityGateStatus
from cairn.schemas.geometry_msgs import Twist, TwistWithCovariance, Vector3
from cairn.schemas.nav_msgs import Odometry
from cairn.visual_map.landmark_store import create_landmarks
from cairn_lab.campaign import (
    DeploymentEnded,
    GoalEnded,
    Injection,
    Invariant,
    LogLine,
    ProcessSample,
)
from cairn_lab.campaign.entry_points import instance_of
from cairn_lab.campaign.invariants import INVARIANTS
from cairn_lab.campaign.observations import Role

DEPLOYMENT = Deployment.model_validate(
    {
        "cairn": 1,
        "components": {
            "mobile": {"plugin": "supervisor", "children": {"base": {"plugin": "test_faulty"}}}
        },
    }
)


def made(kind: str, **parameters: Any) -> Any:
    invariant = instance_of(INVARIANTS, kind, parameters)
    assert not list(invariant.on_start(0.0, DEPLOYMENT))
    return invariant


def process(
    pid: int,
    name: str,
    parent: str = "zygote",
    *,
    memory_mib: float = 50.0,
    threads: int = 8,
) -> ProcessSample:
    role: Role = "component" if name in ("mobile", "base") else "helper"
    return ProcessSample(pid, name, parent, role, pid, memory_mib, 20, threads)


def judged(
    invariant: Invariant, *samples: Sequence[ProcessSample], step_s: float = 1.0
) -> list[str]:
    """Return what an invariant reports of samples, `step_s` [s] apart."""
    root = ProcessSample(1, "root", "", "root", 1.0, 50.0, 20, 8)
    zygote = ProcessSample(2, "zygote", "root", "zygote", 2.0, 50.0, 20, 1)
    found: list[str] = []
    for number, sample in enumerate(samples):
        processes = {one.pid: one for one in (root, zygote, *sample)}
        found += invariant.on_processes(number * step_s, processes)
    return found


def ended(
    report: Path = Path(), *, expected: bool = True, left: Iterable[str] = ()
) -> DeploymentEnded:
    return DeploymentEnded(
        100.0, expected, 1, (report,), tuple(left), ("failed: too many restarts",)
    )


def test_collision_is_reported() -> None:
    collision = Collision(obstacle="table", x=1.0, y=2.0, speed=0.4)

    (text,) = made("no_collision").on_message(3.0, "collisions", collision)

    assert text == "the robot touched table at 1.00, 2.00 with 0.40 m/s"


@pytest.mark.parametrize(
    ("state", "reason", "violations"),
    [
        ("succeeded", "", 0),
        ("failed", "no path to the goal", 0),
        ("failed", "", 1),
        ("lost", "the deployment has ended", 0),
        ("late", "not ended", 1),
    ],
)
def test_goal_must_end_in_time_and_with_a_reason(state: str, reason: str, violations: int) -> None:
    goal = GoalEnded(10.0, (1.0, 2.0, 0.0), state, reason, 5.0)

    assert len(list(made("goals_end").on_goal(goal))) == violations


def test_only_an_end_that_the_campaign_did_not_cause_is_reported() -> None:
    assert not list(made("stays_up").on_end(ended()))
    (text,) = made("stays_up").on_end(ended(expected=False))
    assert "too many restarts" in text


@pytest.mark.parametrize(
    ("stray", "problem"),
    [
        (process(9, "sleep 1000", ""), "has lost its parent"),
        (process(9, "sleep 1000", "zygote"), "belongs to no component"),
        (process(9, "base"), "runs beside 5, an earlier one"),
    ],
    ids=["without parent", "below the zygote", "twin"],
)
def test_orphan_is_reported_once_if_it_stays(stray: ProcessSample, problem: str) -> None:
    healthy = [process(5, "base"), process(6, "sleep 1000", "base")]

    found = judged(made("no_orphan", patience_s=2), *[[*healthy, stray]] * 9)
    passing = judged(made("no_orphan", patience_s=2), [*healthy, stray], *[healthy] * 9)

    assert len(found) == 1
    assert problem in found[0]
    assert passing == []


def test_process_that_outlives_the_deployment_is_reported() -> None:
    assert not list(made("no_orphan").on_end(ended()))
    (text,) = made("no_orphan").on_end(ended(left=["17 sleep 1000"]))
    assert text == "process 17 sleep 1000 outlived the deployment"


@pytest.mark.parametrize(
    ("line", "violations"),
    [
        ("12:00:00.000 WARNING robot.mobile: child failed: base: killed by SIGKILL", 0),
        ("12:00:00.000 WARNING robot.root: child failed: mobile: killed by SIGKILL", 0),
        ("12:00:00.000 WARNING robot.root: child failed: other: killed by SIGKILL", 1),
        ("12:00:00.000 INFO    robot.mobile: child active: base", 1),
    ],
)
def test_process_that_ends_without_a_reason_in_the_log_is_reported(
    line: str, violations: int
) -> None:
    invariant = made("ends_have_reasons", patience_s=2)
    found = judged(invariant, [process(5, "base")], [])
    found += invariant.on_log(LogLine.parsed(1.0, line))
    found += judged(invariant, *[[]] * 5)

    assert len(found) == violations


def leaking(age: int) -> Sequence[ProcessSample]:
    return [process(5, "base", memory_mib=50.0 + 0.05 * age)]


def steady(age: int) -> Sequence[ProcessSample]:
    return [process(5, "base", memory_mib=50.0 + (age % 3) + 40.0 * (age < 50))]


def searching(age: int) -> Sequence[ProcessSample]:
    """Of a process that ends while it uses memory for something, as it did before."""
    return [process(5, "base", memory_mib=50.0 + 20.0 * (age >= 480))]


def restarted(age: int) -> Sequence[ProcessSample]:
    """Of one process after the other, each larger than the one before."""
    start = age // 25
    return [process(5 + start, "base", threads=8 + start)]


def restarted_equal(age: int) -> Sequence[ProcessSample]:
    return [process(5 + age // 25, "base", memory_mib=50.0 + 0.2 * (age % 25))]


@pytest.mark.parametrize(
    ("history", "problem"),
    [
        (leaking, "base: memory grew from"),
        (steady, ""),
        (searching, ""),
        (restarted, "base: threads grew from"),
        (restarted_equal, ""),
    ],
)
def test_growth_is_judged_after_the_warm_up_and_at_equal_age(
    history: Callable[[int], Sequence[ProcessSample]], problem: str
) -> None:
    invariant = made("bounded_growth", warm_up_s=300, restarted_age_s=60)
    judged(invariant, *map(history, range(500)), step_s=5.0)

    found = list(invariant.on_finish(2500.0))

    assert len(found) == bool(problem)
    assert all(problem in text for text in found)


def test_topic_that_falls_silent_is_reported_until_it_is_published_again() -> None:
    invariant = made("keeps_publishing", topics={"odom": "nav_msgs/msg/Odometry"}, patience_s=5)
    found = []
    for second in range(20):
        if second < 4:
            invariant.on_message(float(second), "odom", Odometry())
        found += invariant.on_processes(float(second), {})

    assert found == ["nothing was published on odom for 6 s"] * 2


def moving(speed: float) -> Odometry:
    return Odometry(twist=TwistWithCovariance(twist=Twist(linear=Vector3(x=speed))))


@pytest.mark.parametrize(
    ("topic", "message", "violations"),
    [
        ("odom", moving(0.3), 0),
        ("odom", moving(0.0), 1),
        ("navigation_status", NavigationStatus(state=4, reason="an obstacle is in the way"), 0),
        ("navigation_status", NavigationStatus(state=NavigationStatus.SUCCEEDED), 0),
        ("velocity_gate_status", VelocityGateStatus(reason="emergency stop"), 0),
    ],
)
def test_robot_that_stands_with_a_goal_needs_a_reason(
    topic: str, message: Any, violations: int
) -> None:
    invariant = made("stands_with_reason", patience_s=5)
    driving = NavigationStatus(state=NavigationStatus.DRIVING)
    found = list(invariant.on_message(0.0, "navigation_status", driving))
    for second in range(10):
        found += invariant.on_message(float(second), topic, message)
        found += invariant.on_processes(float(second), {})

    assert len(found) == violations


def test_published_change_of_the_map_that_is_not_in_the_file_is_reported(tmp_path: Path) -> None:
    create_landmarks(tmp_path / "visual_map.cairn", "a test").close()
    invariant = made("map_changes_kept")
    full = Injection("root", "", 5.0)
    assert not list(invariant.on_end(ended(tmp_path)))

    list(invariant.on_message(1.0, "visual_map_changes", VisualMapChange(version=7, object_id=3)))
    list(invariant.on_fault(2.0, "disk_full", full))
    list(invariant.on_message(3.0, "visual_map_changes", VisualMapChange(version=8, object_id=3)))
    list(invariant.on_undo(4.0, "disk_full", full))

    (text,) = invariant.on_end(ended(tmp_path))
    assert text.startswith("change 7 of the visual map, of object 3")
    assert not list(invariant.on_end(ended(tmp_path))), "reported once"
