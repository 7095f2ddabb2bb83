"""Cairn's own messages of navigation: orders to move, plans, motion and how well all that goes."""

import re
from math import isinf, isnan, nan
from typing import Annotated, ClassVar, Final

from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.field_types import Bool, FiniteFloat64, Float64, Scalar, String, UInt8, UInt32
from cairn.schemas.geometry_msgs import Pose, PoseWithCovariance
from cairn.schemas.message import message, reject
from cairn.schemas.packed import Packed
from cairn.schemas.std_msgs import Header

Probability = Annotated[float, Scalar("float64", at_least=0, at_most=1)]
NotNegative = Annotated[float, Scalar("float64", at_least=0)]


@message("cairn_nav_msgs/msg/NavigateGoal")
class NavigateGoal:
    """What the robot is ordered to do: reach `goals` in frame map, from number `first` on.

    `mission_id` counts the orders, 0 before the first. Without goals there is nothing to do: the
    order is done, or was taken back.
    """

    header: Header = Header()
    mission_id: UInt32 = 0
    first: UInt32 = 0
    goals: Packed[Pose] = Packed(Pose)


@message("cairn_nav_msgs/msg/NavCommand")
class NavCommand:
    """AutoMove's current command to the path planner and motion control; repeated periodically.

    `goal_id` identifies the command: a plan and a motion status carry the goal_id that they belong
    to. STAND: stand still. FOLLOW: plan to `goal` and follow the plan. BACK_OFF, LOOK_AROUND,
    EXPLORE: without a plan, back off a little, turn around once, or drive `distance` [m] to where
    there is free space.
    """

    STAND: ClassVar[UInt8] = 0
    FOLLOW: ClassVar[UInt8] = 1
    BACK_OFF: ClassVar[UInt8] = 2
    LOOK_AROUND: ClassVar[UInt8] = 3
    EXPLORE: ClassVar[UInt8] = 4

    header: Header = Header()
    goal_id: UInt32 = 0
    behavior: Annotated[int, Scalar("uint8", at_most=4)] = 0
    goal: Pose = Pose()
    distance: NotNegative = 0.0
    position_tolerance: NotNegative = 0.1
    heading_tolerance: NotNegative = 0.1


@message("cairn_nav_msgs/msg/Plan")
class Plan:
    """The planner's answer to a goal_id: poses to follow in frame map, or why there are none.

    `length` [m] is the way along `poses`; `nearest_x`, `nearest_y` [m] is the reachable place
    nearest to the goal where there is no path to it, NaN if there is none.
    """

    FOUND: ClassVar[UInt8] = 0
    NOT_READY: ClassVar[UInt8] = 1
    START_BLOCKED: ClassVar[UInt8] = 2
    GOAL_BLOCKED: ClassVar[UInt8] = 3
    OUTSIDE_MAP: ClassVar[UInt8] = 4
    UNREACHABLE: ClassVar[UInt8] = 5

    header: Header = Header()
    goal_id: UInt32 = 0
    outcome: Annotated[int, Scalar("uint8", at_most=5)] = 0
    reason: String = ""
    length: NotNegative = 0.0
    nearest_x: Float64 = nan
    nearest_y: Float64 = nan
    poses: Packed[Pose] = Packed(Pose)

    def __post_init__(self) -> None:
        """Check that the nearest place has both coordinates or none."""
        x, y = self.nearest_x, self.nearest_y
        if isinf(x) or isinf(y) or isnan(x) != isnan(y):
            reject(self, "nearest_x, nearest_y", (x, y), "must be two finite numbers, or NaN twice")


@message("cairn_nav_msgs/msg/MotionStatus")
class MotionStatus:
    """What motion control does for a goal_id, and why.

    STANDING: nothing else is wanted. MOVING: on the way. BLOCKED: something is in the way, or there
    is no plan. DONE: the goal is reached, or the behavior is finished. STOPPED: an input is stale,
    which `reason` names.
    """

    STANDING: ClassVar[UInt8] = 0
    MOVING: ClassVar[UInt8] = 1
    BLOCKED: ClassVar[UInt8] = 2
    DONE: ClassVar[UInt8] = 3
    STOPPED: ClassVar[UInt8] = 4

    header: Header = Header()
    goal_id: UInt32 = 0
    state: Annotated[int, Scalar("uint8", at_most=4)] = 0
    reason: String = ""
    distance_left: NotNegative = 0.0
    speed: FiniteFloat64 = 0.0
    clearance: NotNegative = 0.0


@message("cairn_nav_msgs/msg/NavigationStatus")
class NavigationStatus:
    """How an order to move gets on: AutoMove's feedback, and in the end its result.

    `goal` is the number of the goal being driven to, of `goals`; `distance_left` [m] and
    `time_left` [s] are to that goal, `elapsed` [s] and `recoveries` of the whole order.
    """

    LOADING: ClassVar[UInt8] = 0
    LOCALIZING: ClassVar[UInt8] = 1
    PLANNING: ClassVar[UInt8] = 2
    DRIVING: ClassVar[UInt8] = 3
    RECOVERING: ClassVar[UInt8] = 4
    SUCCEEDED: ClassVar[UInt8] = 5
    FAILED: ClassVar[UInt8] = 6
    CANCELED: ClassVar[UInt8] = 7

    header: Header = Header()
    mission_id: UInt32 = 0
    state: Annotated[int, Scalar("uint8", at_most=7)] = 0
    goal: UInt32 = 0
    goals: UInt32 = 0
    distance_left: NotNegative = 0.0
    time_left: NotNegative = 0.0
    elapsed: NotNegative = 0.0
    recoveries: UInt32 = 0
    reason: String = ""


NAVIGATION_STATES: Final = {
    NavigationStatus.LOADING: "loading",
    NavigationStatus.LOCALIZING: "localizing",
    NavigationStatus.PLANNING: "planning",
    NavigationStatus.DRIVING: "driving",
    NavigationStatus.RECOVERING: "recovering",
    NavigationStatus.SUCCEEDED: "succeeded",
    NavigationStatus.FAILED: "failed",
    NavigationStatus.CANCELED: "canceled",
}
"""What the states of a `NavigationStatus` are called."""
NAVIGATION_END_STATES: Final = frozenset(
    {NavigationStatus.SUCCEEDED, NavigationStatus.FAILED, NavigationStatus.CANCELED}
)
"""The states that are the result of an order."""


def without_numbers(reason: str) -> str:
    """The words of a reason: ages and distances within it change all the time, which is no news."""
    return re.sub(r"[0-9.]+", "", reason)


@message("cairn_nav_msgs/msg/LocalizationHealth")
class LocalizationHealth:
    """How far the robot's pose can be relied on: `health` from 0 (lost) to 1, and why.

    `position_sd` [m] and `heading_sd` [rad] are the pose's standard deviations; `scan_fit` is the
    share of the scan that the map explains, NaN without a scan; `objects_agreeing` and
    `objects_contradicting` count the places of mapped objects seen of late. Without a pose
    `located` is false.
    """

    header: Header = Header()
    located: Bool = False
    health: Probability = 0.0
    position_sd: NotNegative = 0.0
    heading_sd: NotNegative = 0.0
    scan_fit: Float64 = nan
    objects_agreeing: UInt32 = 0
    objects_contradicting: UInt32 = 0
    particles: UInt32 = 0
    reason: String = ""


@message("cairn_nav_msgs/msg/Relocalization")
class Relocalization:
    """The robot was lost and has found itself at `pose` in frame map.

    Until `sure_until` objects at two places had agreed that it was where it believed to be: what it
    made of things since then may be wrong. Zero if that is not known.
    """

    header: Header = Header()
    pose: PoseWithCovariance = PoseWithCovariance()
    sure_until: Time = Time()


@message("cairn_nav_msgs/msg/Collision")
class Collision:
    """The robot touched something: what, where [m], and how fast it was [m/s]."""

    header: Header = Header()
    what: String = ""
    x: FiniteFloat64 = 0.0
    y: FiniteFloat64 = 0.0
    speed: NotNegative = 0.0
