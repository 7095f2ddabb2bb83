"""The component Explorer on its ports: goals, their results, operators, restarts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cairn import SECOND, CairnError, from_ns
from cairn.components.explorer.component import Explorer
from cairn.planar.grid import OccupancyCells, map_message
from cairn.planar.messages import packed_poses, planar_poses, pose_message
from cairn.planar.poses import Pose
from cairn.planar.zones import zone_of
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.cairn_nav_msgs import (
    ExplorationStatus,
    LocalizationEstimate,
    NavigateGoal,
    NavigationStatus,
    Zones,
)
from cairn.schemas.geometry_msgs import PoseWithCovariance
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness
from tests.components.path_planner.rooms import room
from tests.wording import assert_words, words_in_order
from tests.zone_features import area

HALF = room(unknown=[(5.0, 0.1, 8.9, 6.9)])
KNOWN = room()
LOST = LocalizationEstimate(located=False, reason="no place of the map is recognized yet")


class ExplorerHarness(ComponentHarness[Explorer]):
    """An explorer, and the test as its supervisor, AutoMove and slam."""

    def __init__(
        self,
        folder: Path,
        *,
        restarts: int = 0,
        simulated_time: bool = False,
        **parameters: object,
    ) -> None:
        super().__init__(
            Explorer,
            {"state_file": str(folder / "exploration.json"), **parameters},
            restarts=restarts,
            simulated_time=simulated_time,
            name="explorer",
        )
        self.mission = 0

    def see(self, grid: OccupancyCells) -> None:
        self.publish("map", map_message(Header(frame_id="map"), grid, Time()))
        pose = PoseWithCovariance(pose=pose_message((2.0, 3.5, 0.0)))
        self.publish("localization", LocalizationEstimate(located=True, pose=pose, health=1.0))

    def goal(self) -> Pose:
        """The goal that it has published since the last call."""
        (request,) = self.take("exploration_goal")
        ((x, y, theta),) = planar_poses(request.goals).tolist()
        return x, y, theta

    def accept(self, *goals: Pose) -> None:
        """Publish a mission to these goals as the supervisor does; none: it is closed."""
        self.mission += bool(goals)
        poses = packed_poses(np.array(goals, float).reshape(-1, 3))
        self.publish("navigate_goal", NavigateGoal(mission_id=self.mission, goals=poses))

    def report(self, state: int, reason: str = "") -> None:
        status = NavigationStatus(mission_id=self.mission, state=state, reason=reason)
        self.publish("navigation_status", status)

    @property
    def status(self) -> ExplorationStatus:
        last: ExplorationStatus = self.take("exploration_status")[-1]
        return last

    def start(self) -> Pose:
        """Explore the half-known room; return the goal, which is accepted."""
        self.see(HALF)
        self.request("explore")
        self.run_for(1.0)
        goal = self.goal()
        self.accept(goal)
        return goal


@pytest.fixture
def explorer(tmp_path: Path) -> ExplorerHarness:
    return ExplorerHarness(tmp_path)


def test_idle_until_it_is_requested(explorer: ExplorerHarness) -> None:
    explorer.see(HALF)
    explorer.run_for(5.0)
    assert explorer.take("exploration_goal") == []
    assert explorer.status.state == ExplorationStatus.IDLE


def test_robot_is_sent_to_the_frontier_and_the_end_is_that_nothing_is_unknown(
    explorer: ExplorerHarness,
) -> None:
    x, y, _ = explorer.start()
    assert 4.0 < x < 4.8
    assert abs(y - 3.5) < 0.2
    status = explorer.status
    assert (status.state, status.frontiers) == (ExplorationStatus.EXPLORING, 1)
    assert status.goal_x == pytest.approx(x)
    assert status.goal_y == pytest.approx(y)

    cells = KNOWN.values
    update = OccupancyGridUpdate(width=cells.shape[1], height=cells.shape[0], data=cells.ravel())
    explorer.publish("map_updates", update)
    explorer.run_for(2.0)
    assert explorer.status.state == ExplorationStatus.EXPLORING  # the map may still change
    explorer.run_for(2.0)
    status = explorer.status
    assert status.state == ExplorationStatus.FINISHED
    assert status.known_area == pytest.approx(8.8 * 6.8, rel=0.02)


def test_goal_is_replaced_once_its_frontier_is_known_and_canceled_at_the_end(
    explorer: ExplorerHarness,
) -> None:
    explorer.start()
    explorer.see(room(unknown=[(7.0, 0.1, 8.9, 6.9)]))
    explorer.run_for(1.0)
    x, _, _ = second = explorer.goal()
    assert 6.0 < x < 6.8
    explorer.accept(second)

    explorer.request("stop")
    (cancel,) = explorer.take("exploration_goal")
    assert len(cancel.goals) == 0
    assert (explorer.status.state, explorer.runtime.state.value) == (3, "active")


def test_mission_of_an_operator_ends_the_exploration(explorer: ExplorerHarness) -> None:
    explorer.start()
    explorer.accept((1.0, 1.0, 0.0))
    status = explorer.status
    assert (status.state, status.reason) == (ExplorationStatus.STOPPED, "preempted by mission 2")
    explorer.take("exploration_goal")
    explorer.report(NavigationStatus.SUCCEEDED)
    explorer.accept()
    explorer.run_for(60.0)
    assert explorer.take("exploration_goal") == []


def test_exploration_is_refused_while_a_mission_is_under_way(explorer: ExplorerHarness) -> None:
    explorer.see(HALF)
    explorer.accept((1.0, 1.0, 0.0))
    with pytest.raises(CairnError, match=words_in_order("mission 1", "cairn go --cancel")):
        explorer.request("explore")
    explorer.accept()
    assert explorer.request("explore")["state"] == "exploring"


@pytest.mark.parametrize("reported", [True, False])
def test_canceled_goal_ends_the_exploration(explorer: ExplorerHarness, reported: bool) -> None:
    explorer.start()
    explorer.accept()
    if reported:
        explorer.report(NavigationStatus.CANCELED)
    explorer.run_for(8.0)
    status = explorer.status
    assert (status.state, status.reason) == (ExplorationStatus.STOPPED, "its goal was canceled")


def test_frontier_that_is_not_reached_is_given_up_after_three_tries(
    explorer: ExplorerHarness,
) -> None:
    explorer.start()
    for tries in (1, 2, 3):
        explorer.report(NavigationStatus.FAILED, "no path")
        explorer.run_for(1.0)
        if tries < 3:
            x, _, _ = goal = explorer.goal()
            assert x == pytest.approx(4.975)  # from nearer than at first
            explorer.accept(goal)
    explorer.run_for(4.0)
    status = explorer.status
    assert (status.state, status.given_up) == (ExplorationStatus.FINISHED, 1)
    assert "but for 1 frontier that" in status.reason


def test_frontier_that_stays_unknown_after_arrival_counts_as_a_try(
    explorer: ExplorerHarness,
) -> None:
    first = explorer.start()
    explorer.report(NavigationStatus.SUCCEEDED)
    explorer.accept()
    explorer.run_for(2.0)
    assert explorer.take("exploration_goal") == []  # the map follows
    explorer.run_for(2.0)
    assert explorer.goal()[0] > first[0]


def test_exploration_ends_if_what_is_unknown_is_behind_a_keepout_zone(
    explorer: ExplorerHarness,
) -> None:
    explorer.start()
    stairs = zone_of(area("keepout", (4.0, 0.0, 4.5, 7.0)))
    explorer.publish("zones", Zones(version=1, zones=(stairs,)))
    explorer.run_for(4.0)
    status = explorer.status
    assert (status.state, status.frontiers) == (ExplorationStatus.FINISHED, 0)
    assert status.reason == "nothing that the robot can reach is unknown"
    (cancel,) = explorer.take("exploration_goal")
    assert len(cancel.goals) == 0

    explorer.publish("zones", Zones(version=2))
    explorer.accept()
    explorer.request("explore")
    explorer.run_for(1.0)
    assert 4.0 < explorer.goal()[0] < 4.8


@pytest.mark.parametrize("step_to_s", [50, 5000], ids=["back", "ahead"])
def test_step_of_the_clock_changes_no_decision(tmp_path: Path, step_to_s: int) -> None:
    explorer = ExplorerHarness(tmp_path, simulated_time=True)

    def pass_time(begin_s: int, end_s: int) -> None:
        for tenths in range(10 * begin_s, 10 * end_s):
            explorer.publish("clock", Clock(clock=from_ns(tenths * SECOND // 10)))

    pass_time(1000, 1001)
    explorer.see(HALF)
    explorer.request("explore")
    pass_time(1001, 1003)
    explorer.accept(explorer.goal())
    explorer.report(NavigationStatus.SUCCEEDED)
    explorer.accept()

    pass_time(step_to_s, step_to_s + 5)

    assert explorer.goal()[0] > 4.0  # the next try
    assert 0.0 < explorer.status.elapsed < 8.0


def test_goal_that_nobody_accepts_is_sent_again_and_fails_in_the_end(
    explorer: ExplorerHarness,
) -> None:
    explorer.see(HALF)
    explorer.request("explore")
    explorer.run_for(50.0)
    assert len(explorer.take("exploration_goal")) == 3
    explorer.run_for(60.0)
    status = explorer.status
    assert status.state == ExplorationStatus.FAILED
    assert "no answer to goals on /robot/exploration_goal" in status.reason


def test_robot_that_is_not_located_gets_a_goal_and_explores_once_it_is(
    explorer: ExplorerHarness,
) -> None:
    explorer.see(HALF)
    explorer.publish("localization", LOST)
    explorer.request("explore")
    explorer.run_for(6.0)
    assert explorer.goal() == (0.0, 0.0, 0.0)  # AutoMove looks around first
    explorer.accept((0.0, 0.0, 0.0))
    explorer.report(NavigationStatus.FAILED, "not located")
    explorer.run_for(1.0)
    assert explorer.goal() == (0.0, 0.0, 0.0)
    explorer.accept((0.0, 0.0, 0.0))

    explorer.see(HALF)
    explorer.run_for(1.0)

    assert 4.0 < explorer.goal()[0] < 4.8
    assert explorer.status.given_up == 0


def test_robot_that_is_never_located_fails_with_what_an_operator_can_do(
    explorer: ExplorerHarness,
) -> None:
    explorer.see(HALF)
    explorer.publish("localization", LOST)
    explorer.request("explore")
    explorer.run_for(310.0)
    status = explorer.status
    assert status.state == ExplorationStatus.FAILED
    assert_words(status.reason, "no place of the map is recognized yet for 300 s", "drive by hand")


def test_missing_map_fails_after_a_minute(explorer: ExplorerHarness) -> None:
    explorer.request("explore")
    explorer.run_for(50.0)
    status = explorer.status
    assert (status.state, status.reason) == (
        ExplorationStatus.EXPLORING,
        "no map yet on /robot/map",
    )
    explorer.run_for(15.0)
    assert explorer.status.state == ExplorationStatus.FAILED


def test_restarted_explorer_continues_and_knows_its_own_goal(tmp_path: Path) -> None:
    goal = ExplorerHarness(tmp_path).start()

    again = ExplorerHarness(tmp_path, restarts=1)
    again.accept(goal)  # as the latched topic has it
    again.see(HALF)
    again.run_for(1.0)
    assert again.status.state == ExplorationStatus.EXPLORING
    again.request("stop")

    ended = ExplorerHarness(tmp_path, restarts=2)
    ended.see(HALF)
    ended.run_for(1.0)
    assert ended.status.state == ExplorationStatus.IDLE


def test_new_run_does_not_continue_an_exploration(tmp_path: Path) -> None:
    ExplorerHarness(tmp_path).start()
    assert ExplorerHarness(tmp_path).status.state == ExplorationStatus.IDLE


def test_explorer_that_is_to_finish_ends_with_the_exploration(tmp_path: Path) -> None:
    explorer = ExplorerHarness(tmp_path, explore="on_activation", finish=True)
    explorer.see(KNOWN)
    explorer.run_for(5.0)
    assert explorer.end is not None
    assert explorer.end.normal
    assert explorer.end.success
