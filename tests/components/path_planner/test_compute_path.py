"""`compute_path_to_pose`, Nav2's action of planner servers: a path, or Nav2's error code."""

import itertools

import pytest

from cairn.components.path_planner.component import PathPlanner
from cairn.planar.messages import planar_pose, pose_message
from cairn.planar.poses import Pose, distance
from cairn.schemas.action_msgs.msg import GoalStatus
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.schemas.nav2_msgs.action import ComputePathToPose
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness
from tests.components.path_planner.planner_harness import DOOR, HERE, THERE, start_planner
from tests.components.path_planner.rooms import room
from tests.wording import assert_words

CODES = ComputePathToPose.Result


def stamped(pose: Pose, frame: str = "map") -> PoseStamped:
    return PoseStamped(header=Header(frame_id=frame), pose=pose_message(pose))


def compute(
    planner: ComponentHarness[PathPlanner],
    goal: PoseStamped,
    start: PoseStamped | None = None,
    planner_id: str = "",
) -> ComputePathToPose.Result:
    asked = ComputePathToPose.Goal(
        goal=goal, start=start or PoseStamped(), use_start=start is not None, planner_id=planner_id
    )
    sent = planner.send_goal("compute_path_to_pose", ComputePathToPose, asked)
    planner.run_for(0.1)
    result = sent.result
    assert result is not None
    found = result.error_code == CODES.NONE
    assert sent.status == (GoalStatus.STATUS_SUCCEEDED if found else GoalStatus.STATUS_ABORTED)
    assert bool(result.path.poses) == found
    return result


def test_path_leads_from_the_robot_or_the_start_to_the_goal() -> None:
    planner = start_planner(room(DOOR))
    for start, begin in ((None, HERE), (stamped((3.0, 6.0, 0.0)), (3.0, 6.0, 0.0))):
        path = compute(planner, stamped(THERE), start, planner_id="GridBased").path

        poses = [planar_pose(pose.pose) for pose in path.poses]
        assert path.header.frame_id == "map"
        assert distance(poses[0], begin) < 0.1
        assert poses[-1] == pytest.approx(THERE)
        assert max(distance(a, b) for a, b in itertools.pairwise(poses)) < 0.3


def test_robot_is_not_driven_and_its_own_plan_stays() -> None:
    planner = start_planner(room(DOOR))
    compute(planner, stamped(THERE))
    assert planner.take("plan") == []
    assert planner.take("path") == []


FAR = (1e300, 1.0, 0.0)


@pytest.mark.parametrize(
    ("goal", "start", "name", "code", "words"),
    [
        (stamped(FAR), None, "", CODES.GOAL_OUTSIDE_MAP, ("goal", "not a valid position")),
        (stamped((90.0, 1.0, 0.0)), None, "", CODES.GOAL_OUTSIDE_MAP, ("outside the map",)),
        (stamped(THERE), stamped(FAR), "", CODES.START_OUTSIDE_MAP, ("start", "outside the map")),
        (stamped(THERE), stamped((0.0, 0.0, 0.0)), "", CODES.START_OCCUPIED, ("(0.00, 0.00)",)),
        (stamped((2.5, 5.0, 0.0)), None, "", CODES.GOAL_OCCUPIED, ("(2.50, 5.00)",)),
        (stamped((8.0, 5.0, 0.0)), None, "", CODES.NO_VALID_PATH, ("(8.00, 5.00)",)),
        (stamped(THERE, "odom"), None, "", CODES.TF_ERROR, ("goal", "frame odom")),
        (stamped(THERE), stamped(HERE, "odom"), "", CODES.TF_ERROR, ("start", "frame odom")),
        (stamped(THERE), None, "Hybrid", CODES.INVALID_PLANNER, ("'Hybrid'", "planner_id")),
    ],
)
def test_failure_has_the_code_of_nav2_and_a_reason(
    goal: PoseStamped, start: PoseStamped | None, name: str, code: int, words: tuple[str, ...]
) -> None:
    boxes = [(2.0, 4.0, 3.5, 6.0), (4.5, 0.0, 4.6, 7.0)]
    result = compute(start_planner(room(boxes)), goal, start, name)

    assert result.error_code == code, result.error_msg
    assert_words(result.error_msg, *words)


def test_without_map_or_pose_the_missing_topic_is_named() -> None:
    result = compute(start_planner(None), stamped(THERE))
    assert result.error_code == CODES.TIMEOUT
    assert_words(result.error_msg, "no map", "/map")

    planner = start_planner(room(), pose=None)
    result = compute(planner, stamped(THERE))
    assert result.error_code == CODES.TF_ERROR
    assert_words(result.error_msg, "localization")
    assert compute(planner, stamped(THERE), stamped(HERE)).error_code == CODES.NONE
