"""Slam goes on with its map: after a restart, a restart of odometry, and while the disk is full."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from cairn import CairnError
from cairn.components.slam.component import Slam
from cairn.components.slam.graph_file import GraphFile, read_graph
from cairn.components.slam.mapping import Mapper
from cairn.planar.messages import planar_pose
from cairn.planar.poses import Pose
from cairn.runtime.lifecycle import LifecycleState
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from cairn.testing.lockstep import ComponentHarness, DeploymentHarness
from tests.components.path_planner.rooms import odom_at, room, scan_of
from tests.disk import room_for
from tests.wording import words_in_order

ROOM = room(boxes=[(4.4, 3.0, 6.0, 3.8), (0.1, 3.6, 0.7, 4.8), (2.2, 2.1, 2.6, 2.5)])
HERE: Pose = (3.0, 1.5, 0.4)
MAPPING = Path(__file__).parents[3] / "deploy" / "mapping.yaml"


class SlamHarness(ComponentHarness[Slam]):
    """A slam that maps a room in which the robot stands."""

    def __init__(self, folder: Path, *, restarts: int = 0, start_s: float = 10.0) -> None:
        parameters = {"map_file": str(folder / "map.yaml")}
        super().__init__(Slam, parameters, restarts=restarts, start_s=start_s, name="slam")

    def stand(
        self, seconds: float, odometry: Pose = (0.0, 0.0, 0.0), here: Pose = HERE
    ) -> LocalizationEstimate:
        """Scan the room for so long; return the last estimate."""
        for _ in range(round(5 * seconds)):
            self.publish("odom", odom_at(odometry, self.now))
            self.publish("scan", scan_of(ROOM, here, self.now))
            self.run_for(0.2)
            self.publish("odom", odom_at(odometry, self.now))
        last: LocalizationEstimate = self.take("localization")[-1]
        return last


def pose_of(estimate: LocalizationEstimate) -> Pose:
    assert estimate.located, estimate.reason
    return planar_pose(estimate.pose.pose)


def test_restarted_slam_continues_in_place_also_if_the_robot_has_stood_for_long(
    tmp_path: Path,
) -> None:
    SlamHarness(tmp_path).stand(4.0)  # it is not shut down, as if it were killed

    again = SlamHarness(tmp_path, restarts=1, start_s=500.0).stand(0.4)

    np.testing.assert_allclose(pose_of(again), (0.0, 0.0, 0.0), atol=0.03)


def test_restarted_slam_finds_the_robot_if_odometry_has_restarted_too(tmp_path: Path) -> None:
    SlamHarness(tmp_path).stand(4.0, odometry=(1.0, 2.0, -2.0))

    again = SlamHarness(tmp_path, restarts=1, start_s=15.0).stand(0.4)

    np.testing.assert_allclose(pose_of(again), (0.0, 0.0, 0.0), atol=0.03)


def test_restarted_slam_does_not_trust_odometry_of_a_robot_that_was_carried_away(
    tmp_path: Path,
) -> None:
    SlamHarness(tmp_path).stand(4.0)

    again = SlamHarness(tmp_path, restarts=1, start_s=500.0)
    assert not again.stand(0.4, here=(7.5, 5.5, 2.0)).located


def test_robot_is_where_it_was_when_odometry_restarts(tmp_path: Path) -> None:
    slam = SlamHarness(tmp_path)
    slam.stand(2.0, odometry=(4.0, -3.0, 2.0))

    last = slam.stand(2.0, odometry=(0.0, 0.0, 0.0))

    np.testing.assert_allclose(pose_of(last), (0.0, 0.0, 0.0), atol=0.03)
    assert slam.request("status")["located"]


def test_graph_is_saved_from_any_thread(tmp_path: Path) -> None:
    path = tmp_path / "map.graph"
    file = GraphFile.create(path, 20.0, "test")
    failures: list[Exception] = []

    def save() -> None:
        try:
            file.save(Mapper(20.0))
            file.close()
        except Exception as error:
            failures.append(error)

    thread = threading.Thread(target=save)
    thread.start()
    thread.join()

    assert failures == []
    assert read_graph(path).keyframes == []


@pytest.mark.accuracy
@pytest.mark.slow
def test_full_disk_stops_neither_mapping_nor_exploration(tmp_path: Path) -> None:
    sets = [f"settings.report={tmp_path}", "settings.explore=on_activation"]
    with DeploymentHarness(MAPPING, sets=sets) as robot:
        robot.run_for(4.0)
        before = robot.request("slam", "status")["keyframes"]
        with room_for(0):
            robot.run_for(10.0)
            with pytest.raises(CairnError, match=words_in_order("not saved", "cairn ps")):
                robot.request("slam", "save")
        assert robot.state("slam") is robot.state("explorer") is LifecycleState.ACTIVE
        mapped = robot.request("slam", "status")["keyframes"]
        assert mapped > before + 5

        robot.run_for(15.0)
        assert len(read_graph(tmp_path / "map.graph").keyframes) > mapped
        assert robot.request("explorer", "status")["state"] in ("exploring", "finished")
        assert robot.request("slam", "save")["keyframes"] >= mapped
