"""A client that has nothing of Cairn drives the simulated robot by Nav2's actions."""

from pathlib import Path
from typing import Any

import pytest

from tests.interop.dora_process import dora_node
from tests.navigation.processes import robot_in
from tests.patience import LIMIT_S

pytestmark = [pytest.mark.xdist_group("robots in real time"), pytest.mark.processes]

ACTION = "/robot/navigate_to_pose"
READ: dict[str, dict[str, Any]] = {
    "/tf": {"type": "tf2_msgs/msg/TFMessage", "reliable": True},
    "/tf_static": {"type": "tf2_msgs/msg/TFMessage", "reliable": True, "latched": True},
    "/robot_description": {"type": "std_msgs/msg/String", "reliable": True, "latched": True},
    "/scan": {"type": "sensor_msgs/msg/LaserScan", "reliable": False},
    "/diagnostics": {"type": "diagnostic_msgs/msg/DiagnosticArray", "reliable": True},
}


def goal(x: float, y: float) -> dict[str, Any]:
    """Return a goal in frame map."""
    return {
        "pose": {
            "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "map"},
            "pose": {
                "position": {"x": x, "y": y, "z": 0.0},
                "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
            },
        },
        "behavior_tree": "",
    }


@pytest.mark.accuracy
def test_robot_is_driven_while_localizer_and_planner_are_killed(
    tmp_path: Path, ament: Path
) -> None:
    with (
        robot_in(tmp_path) as robot,
        dora_node(robot.run.endpoint, ament, tmp_path) as dora,
    ):
        dora.do("action_client", name=ACTION, type="nav2_msgs/action/NavigateToPose")

        first = dora.do("send_goal", name=ACTION, goal=goal(6.6, 1.8))
        assert first is not None
        feedback = dora.do("feedback", name=ACTION, goal=first, timeout_s=LIMIT_S)
        assert feedback["distance_remaining"] > 1.0
        robot.await_moved(0.5)
        assert dora.do("cancel", name=ACTION, goal=first) == 0
        robot.await_stand()

        second = dora.do("send_goal", name=ACTION, goal=goal(6.6, 1.8))
        for component in ("localizer", "path_planner"):
            robot.await_moved(0.5)
            robot.kill(component)
            robot.run.await_line(f"child failed: {component}")
        distances: list[float] = []
        silent = 0
        while silent < 20:  # dora's queue also has feedback for the goal before
            found = dora.do("feedback", name=ACTION, goal=second, timeout_s=0.2)
            silent = 0 if found is not None else silent + 1
            if found is not None:
                distances.append(found["distance_remaining"])

        status, result = dora.do("result", name=ACTION, goal=second)
        assert (status, result) == ("succeeded", {"error_code": 0, "error_msg": ""})
        assert min(distances) < 0.5
        x, y, _ = robot.pose
        assert (x, y) == pytest.approx((6.6, 1.8), abs=0.15)
        assert robot.collisions == []

        outside = dora.do("send_goal", name=ACTION, goal=goal(100.0, 1.8))
        status, result = dora.do("result", name=ACTION, goal=outside)
        assert (status, result["error_code"]) == ("aborted", 204)  # GOAL_OUTSIDE_MAP
        assert "is outside the map" in result["error_msg"]
        assert dora.do("send_goal", name=ACTION, goal=goal(float("nan"), 1.8)) is None


@pytest.mark.accuracy
def test_robot_with_names_of_ros_is_found_and_driven_as_one_of_ros(
    tmp_path: Path, ament: Path
) -> None:
    """With `ros_names` a node needs no name of the robot: `/tf`, `/navigate_to_pose`."""
    with (
        robot_in(tmp_path, "ros_names=true") as robot,
        dora_node(robot.run.endpoint, ament, tmp_path) as dora,
    ):
        robot.run.await_line("child active: ros")
        for topic, how in READ.items():
            dora.do("subscribe", topic=topic, **how)
        action = "/navigate_to_pose"
        dora.do("action_client", name=action, type="nav2_msgs/action/NavigateToPose")

        sent = dora.do("send_goal", name=action, goal=goal(2.0, 1.2))
        assert sent is not None
        feedback = dora.do("feedback", name=action, goal=sent, timeout_s=LIMIT_S)
        assert feedback["distance_remaining"] > 0.1
        assert dora.do("result", name=action, goal=sent)[0] == "succeeded"
        read = {topic: dora.do("receive", topic=topic) for topic in READ}

        assert read["/tf"]["transforms"][0]["child_frame_id"] in ("odom", "base_link")
        assert read["/tf_static"]["transforms"][0]["child_frame_id"] == "laser"
        assert '<link name="laser"' in read["/robot_description"]["data"]
        assert read["/scan"]["header"]["frame_id"] == "laser"
        names = [one["name"] for one in read["/diagnostics"]["status"]]
        assert "robot: localizer" in names
        x, y, _ = robot.pose
        assert (x, y) == pytest.approx((2.0, 1.2), abs=0.15)
