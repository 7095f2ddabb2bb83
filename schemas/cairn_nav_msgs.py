"""Cairn's own messages of navigation: missions, commands, plans, motion, localization, zones."""

from enum import IntEnum
from math import isinf, isnan, nan, pi
from typing import Annotated, ClassVar, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.field_types import (
    Array,
    Bool,
    FiniteFloat64,
    Float64,
    Scalar,
    String,
    UInt8,
    UInt32,
    UInt64,
    empty,
    finite,
)
from cairn.schemas.geometry_msgs import Pose, PoseWithCovariance, Twist
from cairn.schemas.message import message, reject
from cairn.schemas.packed import Packed
from cairn.schemas.std_msgs import Header
from cairn.schemas.unique_identifier_msgs.msg import UUID

Probability = Annotated[float, Scalar("float64", at_least=0, at_most=1)]
NotNegative = Annotated[float, Scalar("float64", at_least=0)]


class ReasonCode(IntEnum):
    """Why a component is in its state: the field `reason_code` beside a `reason` in words.

    One numbering for all components: AutoMove passes on the code of whichever component keeps the
    robot from its goal. The words may hold ages and distances that change with each message; the
    code changes when the reason does.
    """

    NONE = 0

    # Localization: what keeps the health of the pose below 1.
    NOT_LOCATED = 1
    POSITION_UNCERTAIN = 2
    HEADING_UNCERTAIN = 3
    SCAN_MISMATCH = 4
    """The grid map explains too few beams of the scan."""
    OBJECTS_CONTRADICT = 5
    UNCONFIRMED = 6
    """Found by a global search, or suspected to be elsewhere, and not confirmed yet."""
    SCAN_HITS_NOTHING = 7
    SCAN_INVALID = 8
    """Hardly any beam of the scans is valid, or all miss obstacles that the map has in reach."""

    # Inputs that are missing or too old.
    NO_NAV_COMMAND = 20
    NO_ODOMETRY = 21
    NO_SCAN = 22
    NO_LOCALIZATION = 23
    ODOMETRY_RESET = 24
    """Odometry jumped, or time was set back: the robot stands for a moment."""
    NO_MOTION_STATUS = 25

    # Planning.
    NO_PLAN = 40
    PLANNER_NOT_READY = 41
    START_BLOCKED = 42
    GOAL_BLOCKED = 43
    GOAL_OUTSIDE_MAP = 44
    GOAL_UNREACHABLE = 45
    GOAL_IN_KEEPOUT = 46
    """The goal is in a keepout zone of the map, or too near to one."""
    IN_KEEPOUT = 47
    """The robot is in a keepout zone."""

    # Driving.
    OFF_PATH = 60
    OBSTACLE = 61
    NO_ROOM = 62
    """There is not enough free space to explore."""
    NO_PROGRESS = 63
    KEEPOUT_ZONE = 64
    """A keepout zone is in the way."""

    # The velocity gate, between the sources of velocity commands and the base.
    EMERGENCY_STOP = 70
    """An emergency stop is engaged; the robot drives on after its release."""
    OPERATOR_DRIVES = 71
    """An operator or another source drives the robot; the navigator waits."""
    NO_GATE_STATUS = 72

    # Missions.
    LOADING = 80
    """`reason` names the component that is being loaded."""
    LOADING_FAILED = 81
    ARRIVED = 82
    CANCELED = 83
    TIMED_OUT = 84
    """The time that a mission was allowed is over."""
    PREEMPTED = 85
    """Another mission has taken its place."""
    NOT_CONTINUED = 86
    """The supervisor was restarted, and does not continue the mission."""


class Reason(NamedTuple):
    """A reason as code (a `ReasonCode`, or a number that a newer version knows) and in words."""

    code: int
    text: str


NO_REASON: Final = Reason(ReasonCode.NONE, "")

ReasonNumber = Annotated[int, Scalar("uint8", at_most=int(max(ReasonCode)))]


MAX_GOALS: Final = 1000
"""A mission has at most so many goals."""

MAX_COORDINATE: Final = 1e5
"""Coordinates of goals are at most so large [m]."""

MAX_POSITION: Final = 1e7
"""Coordinates of the robot are at most so large [m], like those of a visual map."""

MAX_MOTION: Final = 1e6
"""The longest motion without a map [m], [rad]."""


@message("cairn_nav_msgs/msg/NavigateGoal")
class NavigateGoal:
    """The mission that AutoMove carries out: drive to `goals` in frame map, from index `first` on.

    `mission_id` increases with each mission; 0 means that there was none. `goal_id` is that of the
    action's goal for which the mission is. There are at most `MAX_GOALS` goals. Instead of
    goals a mission may have a `motion`, which needs no map: TURN by `amount` [rad] on the spot, or
    REVERSE by |`amount`| [m] straight back, at most at `speed` ([rad/s], [m/s]; 0: as usual) and in
    `time_allowance` [s] (0: any time). Without both there is nothing to do: the mission is
    finished, or was canceled.
    """

    NO_MOTION: ClassVar[UInt8] = 0
    TURN: ClassVar[UInt8] = 1
    REVERSE: ClassVar[UInt8] = 2

    header: Header = Header()
    mission_id: UInt32 = 0
    goal_id: UUID = UUID()
    first: UInt32 = 0
    goals: Packed[Pose] = Packed(Pose)
    motion: Annotated[int, Scalar("uint8", at_most=2)] = 0
    amount: Annotated[float, Scalar("float64", at_least=-MAX_MOTION, at_most=MAX_MOTION)] = 0.0
    speed: NotNegative = 0.0
    time_allowance: NotNegative = 0.0

    def __post_init__(self) -> None:
        """Check the number of goals."""
        if len(self.goals) > MAX_GOALS:
            rule = f"poses are too many: at most {MAX_GOALS}, the further ones in another mission"
            reject(self, "number of goals", len(self.goals), rule)


@message("cairn_nav_msgs/msg/NavCommand")
class NavCommand:
    """AutoMove's current command to the path planner and motion control; repeated periodically.

    `command_id` identifies the command: a plan and a motion status have that of the command to
    which they belong. STAND: stand still. FOLLOW: plan to `goal` and follow the plan. BACK_OFF,
    LOOK_AROUND, EXPLORE: without a plan, back off a little, turn around once, or drive `distance`
    [m] to where there is free space. TURN, REVERSE: turn by `angle` [rad] on the spot, or drive
    `distance` [m] straight back, at most at `speed` ([rad/s], [m/s]; 0: as usual).
    """

    STAND: ClassVar[UInt8] = 0
    FOLLOW: ClassVar[UInt8] = 1
    BACK_OFF: ClassVar[UInt8] = 2
    LOOK_AROUND: ClassVar[UInt8] = 3
    EXPLORE: ClassVar[UInt8] = 4
    TURN: ClassVar[UInt8] = 5
    REVERSE: ClassVar[UInt8] = 6

    header: Header = Header()
    command_id: UInt32 = 0
    behavior: Annotated[int, Scalar("uint8", at_most=6)] = 0
    goal: Pose = Pose()
    distance: NotNegative = 0.0
    angle: FiniteFloat64 = 0.0
    speed: NotNegative = 0.0
    position_tolerance: NotNegative = 0.1
    heading_tolerance: NotNegative = 0.1


@message("cairn_nav_msgs/msg/Plan")
class Plan:
    """The path planner's answer to a command: poses to follow in frame map, or why there are none.

    `length` [m] is the length of the path along `poses`; `nearest_x`, `nearest_y` [m] is the
    reachable position nearest to the goal if no path leads to the goal, NaN if there is none.

    NOT_READY: an input is missing. START_BLOCKED: the robot is in an obstacle. GOAL_BLOCKED: the
    goal is, in one that may go or may have gone. GOAL_IMPOSSIBLE: the goal is in a wall or in
    unknown space. UNREACHABLE: obstacles lie between the two. GOAL_IN_KEEPOUT: the goal is in a
    keepout zone or too near to one. START_IN_KEEPOUT: the robot is in a keepout zone and must not
    leave it by itself.
    """

    FOUND: ClassVar[UInt8] = 0
    NOT_READY: ClassVar[UInt8] = 1
    START_BLOCKED: ClassVar[UInt8] = 2
    GOAL_BLOCKED: ClassVar[UInt8] = 3
    OUTSIDE_MAP: ClassVar[UInt8] = 4
    UNREACHABLE: ClassVar[UInt8] = 5
    GOAL_IMPOSSIBLE: ClassVar[UInt8] = 6
    GOAL_IN_KEEPOUT: ClassVar[UInt8] = 7
    START_IN_KEEPOUT: ClassVar[UInt8] = 8

    header: Header = Header()
    command_id: UInt32 = 0
    outcome: Annotated[int, Scalar("uint8", at_most=8)] = 0
    reason: String = ""
    length: NotNegative = 0.0
    nearest_x: Float64 = nan
    nearest_y: Float64 = nan
    poses: Packed[Pose] = Packed(Pose)

    def __post_init__(self) -> None:
        """Check that the nearest position has both coordinates or none."""
        x, y = self.nearest_x, self.nearest_y
        if isinf(x) or isinf(y) or isnan(x) != isnan(y):
            reject(self, "nearest_x, nearest_y", (x, y), "must be two finite numbers, or NaN twice")


PLAN_REASON_CODES: Final = {
    Plan.FOUND: ReasonCode.NONE,
    Plan.NOT_READY: ReasonCode.PLANNER_NOT_READY,
    Plan.START_BLOCKED: ReasonCode.START_BLOCKED,
    Plan.GOAL_BLOCKED: ReasonCode.GOAL_BLOCKED,
    Plan.OUTSIDE_MAP: ReasonCode.GOAL_OUTSIDE_MAP,
    Plan.UNREACHABLE: ReasonCode.GOAL_UNREACHABLE,
    Plan.GOAL_IMPOSSIBLE: ReasonCode.GOAL_BLOCKED,
    Plan.GOAL_IN_KEEPOUT: ReasonCode.GOAL_IN_KEEPOUT,
    Plan.START_IN_KEEPOUT: ReasonCode.IN_KEEPOUT,
}
"""The reason code of each `Plan.outcome`."""


@message("cairn_nav_msgs/msg/MotionStatus")
class MotionStatus:
    """The state of motion control for a command, and the reason for that state.

    STANDING: the robot is commanded to stand. MOVING: it drives. BLOCKED: an obstacle is in its
    path, or there is no plan. DONE: the goal is reached, or the behavior is finished. STOPPED: an
    input is missing or too old, which `reason` names. `distance_left` [m] is the rest of the path,
    `speed` [m/s] the measured speed, `clearance` [m] the distance to the nearest obstacle.
    """

    STANDING: ClassVar[UInt8] = 0
    MOVING: ClassVar[UInt8] = 1
    BLOCKED: ClassVar[UInt8] = 2
    DONE: ClassVar[UInt8] = 3
    STOPPED: ClassVar[UInt8] = 4

    header: Header = Header()
    command_id: UInt32 = 0
    state: Annotated[int, Scalar("uint8", at_most=4)] = 0
    reason: String = ""
    reason_code: ReasonNumber = 0
    distance_left: NotNegative = 0.0
    speed: FiniteFloat64 = 0.0
    clearance: NotNegative = 0.0


@message("cairn_nav_msgs/msg/NavigationStatus")
class NavigationStatus:
    """The progress of a mission: AutoMove's feedback, and at the end its result.

    `goal_id` is that of the action's goal for which the mission is. `goal` is the index of
    the current goal, of `goals`; `distance_left` [m] and `time_left` [s] are to that goal;
    `elapsed` [s] and `recoveries` count from the start of the mission to its end.
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
    goal_id: UUID = UUID()
    state: Annotated[int, Scalar("uint8", at_most=7)] = 0
    goal: UInt32 = 0
    goals: UInt32 = 0
    distance_left: NotNegative = 0.0
    time_left: NotNegative = 0.0
    elapsed: NotNegative = 0.0
    recoveries: UInt32 = 0
    reason: String = ""
    reason_code: ReasonNumber = 0


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
"""The names of the states of a `NavigationStatus`."""


class MissionOutcome(IntEnum):
    """How a mission ended: the last states of a `NavigationStatus`."""

    SUCCEEDED = NavigationStatus.SUCCEEDED
    FAILED = NavigationStatus.FAILED
    CANCELED = NavigationStatus.CANCELED


NAVIGATION_END_STATES: Final[frozenset[int]] = frozenset(MissionOutcome)
"""The states that are the result of a mission."""


@message("cairn_nav_msgs/msg/ExplorationStatus")
class ExplorationStatus:
    """The progress of exploration, and at its end the result.

    FINISHED: nothing that the robot can reach is unknown. STOPPED: on request, or another mission
    preempted it. FAILED: an input is missing, or goals are not accepted. `reason` says in words why
    it ended, or what the robot does or waits for. `frontiers` counts those that the robot can
    reach, `given_up` those of them that it could not explore in several tries. `known_area` [m^2]
    is the free space of the map, `elapsed` [s] the time since the start. `goal_x` and `goal_y` [m]
    in frame map are the robot's goal, NaN without one.
    """

    IDLE: ClassVar[UInt8] = 0
    EXPLORING: ClassVar[UInt8] = 1
    FINISHED: ClassVar[UInt8] = 2
    STOPPED: ClassVar[UInt8] = 3
    FAILED: ClassVar[UInt8] = 4

    header: Header = Header()
    state: Annotated[int, Scalar("uint8", at_most=4)] = 0
    frontiers: UInt32 = 0
    given_up: UInt32 = 0
    known_area: NotNegative = 0.0
    elapsed: NotNegative = 0.0
    goal_x: Float64 = nan
    goal_y: Float64 = nan
    reason: String = ""

    def __post_init__(self) -> None:
        """Check that the goal has both coordinates or none."""
        x, y = self.goal_x, self.goal_y
        if isinf(x) or isinf(y) or isnan(x) != isnan(y):
            reject(self, "goal_x, goal_y", (x, y), "must be two finite numbers, or NaN twice")


EXPLORATION_STATES: Final = {
    ExplorationStatus.IDLE: "idle",
    ExplorationStatus.EXPLORING: "exploring",
    ExplorationStatus.FINISHED: "finished",
    ExplorationStatus.STOPPED: "stopped",
    ExplorationStatus.FAILED: "failed",
}
"""The names of the states of an `ExplorationStatus`."""


@message("cairn_nav_msgs/msg/AlternativePose")
class AlternativePose:
    """Another position in frame map at which the robot may be, and how probable that is."""

    x: FiniteFloat64 = 0.0
    y: FiniteFloat64 = 0.0
    theta: FiniteFloat64 = 0.0
    probability: Probability = 0.0


@message("cairn_nav_msgs/msg/LocalizationEstimate")
class LocalizationEstimate:
    """Where the robot is in frame map, and how far that estimate can be relied on.

    The stamp is that of the scan or the odometry that gave the pose. `pose` is valid if `located`.
    `health` is from 0 (lost) to 1; `reason` says in words what keeps it below 1, `reason_code` is
    its `ReasonCode`. `position_sd` [m] and `heading_sd` [rad] are standard deviations; `scan_fit`
    is the share of the scan's beams that the grid map explains, NaN without a scan;
    `objects_agreeing` and `objects_contradicting` count the positions of mapped objects observed
    recently. `particles` is the size of the particle set; `alternatives` are the other positions at
    which the robot may be, the most probable first.
    """

    header: Header = Header()
    located: Bool = False
    pose: PoseWithCovariance = PoseWithCovariance()
    health: Probability = 0.0
    position_sd: NotNegative = 0.0
    heading_sd: NotNegative = 0.0
    scan_fit: Float64 = nan
    objects_agreeing: UInt32 = 0
    objects_contradicting: UInt32 = 0
    particles: UInt32 = 0
    alternatives: tuple[AlternativePose, ...] = ()
    reason: String = ""
    reason_code: ReasonNumber = 0

    def __post_init__(self) -> None:
        """Check that the position is on a map: distances from it must be numbers, too."""
        at = self.pose.pose.position
        if max(abs(at.x), abs(at.y)) > MAX_POSITION:
            reject(self, "position", (at.x, at.y), f"must be within {MAX_POSITION:g} m")


@message("cairn_nav_msgs/msg/Relocalization")
class Relocalization:
    """The robot was lost, and a global search has found it at `pose` in frame map.

    Until `confirmed_until` objects at two positions had agreed with the pose that the robot
    believed: conclusions drawn after that time may be wrong. Zero if that time is not known.
    """

    header: Header = Header()
    pose: PoseWithCovariance = PoseWithCovariance()
    confirmed_until: Time = Time()


@message("cairn_nav_msgs/msg/Collision")
class Collision:
    """The robot touched `obstacle` at `x`, `y` [m] in frame map while driving at `speed` [m/s].

    `robot` is its name: there may be several in one simulated world.
    """

    header: Header = Header()
    obstacle: String = ""
    x: FiniteFloat64 = 0.0
    y: FiniteFloat64 = 0.0
    speed: NotNegative = 0.0
    robot: String = ""


@message("cairn_nav_msgs/msg/TeleoperationCommand")
class TeleoperationCommand:
    """An operator's velocity command: accepted with the valid `lease` of the velocity gate alone.

    The stamp is the time of the command by the robot's clock; late commands are refused.
    """

    header: Header = Header()
    lease: UInt64 = 0
    twist: Twist = Twist()


@message("cairn_nav_msgs/msg/VelocityGateStatus")
class VelocityGateStatus:
    """What the velocity gate passes to the base, and what it holds back.

    `source` is the source whose commands drive the robot (navigator, teleoperation, external), ""
    without one; `operator` holds the operator's lease, "" without one. `stopped`: the gate holds
    the robot; `reason` and `reason_code` (a `ReasonCode`) say why. `limits` are the limits that
    were active since the last status. `requested_speed` and `speed` [m/s], `requested_turn` and
    `turn` [rad/s] are those of the source's command and of the command to the base.

    Counts since the gate's start: commands refused because they had no valid lease
    (`refused_lease`), because they were late (`refused_late`), because the base cannot execute them
    (`refused_invalid`), because their source is not enabled (`refused_disabled`); and commands
    that were reduced to the limits (`clamped`).
    """

    header: Header = Header()
    source: String = ""
    operator: String = ""
    emergency_stop: Bool = False
    stopped: Bool = False
    reason: String = ""
    reason_code: ReasonNumber = 0
    limits: tuple[String, ...] = ()
    requested_speed: FiniteFloat64 = 0.0
    requested_turn: FiniteFloat64 = 0.0
    speed: FiniteFloat64 = 0.0
    turn: FiniteFloat64 = 0.0
    refused_lease: UInt32 = 0
    refused_late: UInt32 = 0
    refused_invalid: UInt32 = 0
    refused_disabled: UInt32 = 0
    clamped: UInt32 = 0


MAX_ZONES: Final = 200
"""A map has at most so many zones."""
MAX_ZONE_POINTS: Final = 1000
"""A zone has at most so many points."""
MAX_POINTS_OF_ZONES: Final = 10_000
"""All zones of a map have at most so many points together."""
MAX_ZONE_NAME: Final = 64
"""The name of a zone has at most so many characters."""
FARTHEST_ZONE_M: Final = 1e5
"""Coordinates of zones are at most so large [m], as those of goals."""
SLOWEST_ZONE: Final = 0.05
"""Lowest speed of a slow zone [m/s]: a base can hardly follow slower commands."""
FASTEST_ZONE: Final = 3.0
"""Highest speed of a slow zone [m/s]: that of motion control's parameter."""
WIDEST_LANE_M: Final = 20.0
"""Largest width of a lane [m]."""


@message("cairn_nav_msgs/msg/Zone")
class Zone:
    """A zone on the map, in frame map: an area, a preferred lane, or a named place.

    KEEPOUT: an area that the robot must not enter. SLOW: an area in which it drives at most `speed`
    [m/s]. LANE: a line on which, over `width` [m], paths are preferred. PLACE: a position to drive
    to by its name, with the `heading` [rad] on arrival, NaN if any will do. `speed` and `width` are
    0 in zones of other kinds, `heading` is NaN.

    `points` has x, y [m] of the corners of an area, of the points of a lane, or of the place, one
    after the other. An area may have holes: `rings` has the number of corners of its outline and of
    each hole, in this order; the last corner is joined to the first. For a lane and a place it has
    the number of points.
    """

    KEEPOUT: ClassVar[UInt8] = 0
    SLOW: ClassVar[UInt8] = 1
    LANE: ClassVar[UInt8] = 2
    PLACE: ClassVar[UInt8] = 3

    kind: Annotated[int, Scalar("uint8", at_most=3)] = 0
    name: String = ""
    speed: NotNegative = 0.0
    width: NotNegative = 0.0
    heading: Float64 = nan
    rings: Annotated[npt.NDArray[np.uint32], Array("uint32")] = empty("uint32")
    points: Annotated[npt.NDArray[np.float64], Array("float64", check=finite)] = empty("float64")

    def __post_init__(self) -> None:
        """Check name, numbers of points, bounds, and which fields the kind has."""
        if problem := zone_name_problem(self.name):
            reject(self, "name", self.name[: 2 * MAX_ZONE_NAME], problem)
        count, rings = self.points.size // 2, self.rings.tolist()
        if count > MAX_ZONE_POINTS:
            reject(self, "number of points", count, f"are too many: at most {MAX_ZONE_POINTS}")
        if 2 * sum(rings) != self.points.size or not rings:
            reject(self, "rings", self.rings, f"must sum up to the {self.points.size} / 2 points")
        is_area = self.kind in (Zone.KEEPOUT, Zone.SLOW)
        least = 3 if is_area else 2 if self.kind == Zone.LANE else 1
        if min(rings) < least or (self.kind == Zone.PLACE and count > 1):
            reject(self, "number of points", min(rings), f"of this kind must be {least} or more")
        if not is_area and len(rings) > 1:
            reject(self, "rings", len(rings), "must be one: only areas have holes")
        if count and float(np.abs(self.points).max()) > FARTHEST_ZONE_M:
            reject(self, "points", "a coordinate", f"must be at most {FARTHEST_ZONE_M:g} m")
        slow, lane = self.kind == Zone.SLOW, self.kind == Zone.LANE
        if not (SLOWEST_ZONE <= self.speed <= FASTEST_ZONE if slow else self.speed == 0):
            rule = f"must be {SLOWEST_ZONE:g} to {FASTEST_ZONE:g} m/s in a slow zone, else 0"
            reject(self, "speed", self.speed, rule)
        if not (0.0 < self.width <= WIDEST_LANE_M if lane else self.width == 0):
            rule = f"must be above 0 and at most {WIDEST_LANE_M:g} m for a lane, else 0"
            reject(self, "width", self.width, rule)
        has_heading = not isnan(self.heading)
        if has_heading and not (self.kind == Zone.PLACE and abs(self.heading) <= 2 * pi):
            reject(self, "heading", self.heading, "must be -2 pi to 2 pi for a place, else NaN")


@message("cairn_nav_msgs/msg/Zones")
class Zones:
    """The zones on the map; their names differ. `version` increases with each change.

    The stamp is the time at which they came into force.
    """

    header: Header = Header()
    version: UInt32 = 0
    zones: tuple[Zone, ...] = ()

    def __post_init__(self) -> None:
        """Check the number of zones, and that their names differ."""
        if len(self.zones) > MAX_ZONES:
            reject(self, "number of zones", len(self.zones), f"must be at most {MAX_ZONES}")
        points = sum(zone.points.size // 2 for zone in self.zones)
        if points > MAX_POINTS_OF_ZONES:
            rule = f"must be at most {MAX_POINTS_OF_ZONES:,} together"
            reject(self, "number of points", points, rule)
        names = [zone.name for zone in self.zones]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            reject(self, "name", twice, "is the name of two zones: names must differ")


ZONE_KINDS: Final = {
    Zone.KEEPOUT: "keepout",
    Zone.SLOW: "slow",
    Zone.LANE: "lane",
    Zone.PLACE: "place",
}
"""The names of the kinds of a `Zone`."""


def zone_name_problem(name: str) -> str:
    """Return what is wrong with the name of a zone; empty if it is valid.

    A command must be able to distinguish a name from coordinates and from an option.
    """
    if not 0 < len(name) <= MAX_ZONE_NAME:
        return f"must have 1 to {MAX_ZONE_NAME} characters"
    if not name.isprintable() or name != name.strip() or "," in name:
        return "must have neither control characters, nor commas, nor spaces at its ends"
    if not name[0].isalpha():
        return "must begin with a letter"
    if name.lower() in _NUMBERS:
        return "must not be a number"
    return ""


_NUMBERS: Final = frozenset({"inf", "infinity", "nan"})
