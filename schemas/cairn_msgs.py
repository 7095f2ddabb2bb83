"""Cairn's own messages: observations of objects, the visual map and the status of components."""

from math import isinf, isnan
from typing import Annotated, ClassVar, Final

import numpy as np
import numpy.typing as npt

from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.field_types import (
    Array,
    Bool,
    Covariance2,
    Covariance3,
    FiniteFloat64,
    Float64,
    Scalar,
    String,
    Text,
    UInt8,
    UInt8Array,
    UInt32,
    UInt32Array,
    UInt64,
    empty,
    finite,
    zeros,
)
from cairn.schemas.message import message, reject
from cairn.schemas.std_msgs import Header

Probability = Annotated[float, Scalar("float64", at_least=0, at_most=1)]
Distance = Annotated[float, Scalar("float64", above=0)]
Corners = Annotated[npt.NDArray[np.float64], Array("float64", check=finite)]
NotNegative = Annotated[float, Scalar("float64", at_least=0)]

RobotId = Annotated[str, Text(most=63)]
CellSet = Annotated[npt.NDArray[np.uint8], Array("uint8", length=32)]
Information2 = Annotated[npt.NDArray[np.float64], Array("float64", length=5, check=finite)]

NAN = float("nan")


@message("cairn_msgs/msg/RecognizedObject")
class RecognizedObject:
    """One observation of an object by the camera: its position relative to the robot.

    `range` [m] and `bearing` [rad, left positive] with their covariance; `inliers` is the number
    of matched features, 0 if that does not apply. `alternatives` are ids of other objects that it
    may be as well; `corners` are the object's corners in the left image, u, v [px] of each, or
    empty.
    """

    object_id: UInt32
    range: Distance
    bearing: FiniteFloat64
    covariance: Covariance2 = zeros(4)
    inliers: UInt32 = 0
    alternatives: UInt32Array = empty(np.uint32)
    corners: Corners = empty(np.float64)

    def __post_init__(self) -> None:
        """Check that there are four corners or none."""
        if self.corners.size not in (0, 8):
            reject(self, "corners", self.corners, "must be none, or 8 image coordinates")


@message("cairn_msgs/msg/RecognizedObjectArray")
class RecognizedObjectArray:
    """The objects recognized in one image, possibly none; the frame is the robot's base.

    An object could have been recognized between the bearings `view_right` and `view_left` [rad,
    left positive] and the ranges `nearest` and `farthest` [m]; all zeros: not known.
    """

    header: Header = Header()
    objects: tuple[RecognizedObject, ...] = ()
    view_right: FiniteFloat64 = 0.0
    view_left: FiniteFloat64 = 0.0
    nearest: NotNegative = 0.0
    farthest: NotNegative = 0.0

    def __post_init__(self) -> None:
        """Check that the limits of the view are in order."""
        if not self.view_right <= self.view_left:
            reject(self, "view_left", self.view_left, f"must be {self.view_right} or more")
        if not self.nearest <= self.farthest:
            reject(self, "farthest", self.farthest, f"must be nearest = {self.nearest} or more")


@message("cairn_msgs/msg/ObjectEvidence")
class ObjectEvidence:
    """The evidence of one observation, or of a missing one, about an object's position in the map.

    `similarity` is p(R, NR, i) of the paper's equation 1 and `distance` its d (in likelihood-ratio
    mode the square root of the normalized innovation squared); `x`, `y` [m] with `covariance` is
    the position in the map that the observation implies; `range`, `bearing` repeat the observation.
    `corroborated` is false for a DISAGREES that stands alone: too few observations from other poses
    have contradicted the map in the same way yet. UNSEEN: the object should have been in view, and
    nothing hides it, but it was not recognized; `range` and `bearing` are those of its position in
    the map.
    """

    AGREES: ClassVar[UInt8] = 0
    DISAGREES: ClassVar[UInt8] = 1
    FALSE_MATCH: ClassVar[UInt8] = 2
    NOT_CONVERGED: ClassVar[UInt8] = 3
    UNSEEN: ClassVar[UInt8] = 4

    object_id: UInt32
    similarity: Probability
    verdict: Annotated[int, Scalar("uint8", at_most=4)]
    distance: NotNegative
    x: FiniteFloat64
    y: FiniteFloat64
    covariance: Covariance2
    range: Distance
    bearing: FiniteFloat64
    corroborated: Bool = True


@message("cairn_msgs/msg/ObjectEvidenceArray")
class ObjectEvidenceArray:
    """The evidence of one image, with the robot's pose [m, rad] that it was compared with.

    `reason` says in words why the pose is not `healthy`; `reason_code` is a
    `cairn_nav_msgs.ReasonCode`.
    """

    header: Header = Header()
    robot_x: FiniteFloat64 = 0.0
    robot_y: FiniteFloat64 = 0.0
    robot_theta: FiniteFloat64 = 0.0
    robot_covariance: Covariance3 = zeros(9)
    healthy: Bool = False
    reason: String = ""
    reason_code: UInt8 = 0
    evidence: tuple[ObjectEvidence, ...] = ()


@message("cairn_msgs/msg/VisualObject")
class VisualObject:
    """An object of the visual map: position [m] in frame map, and its reliability.

    The candidate is the position where a moved object seems to be now; NaN if there is none.
    """

    LIVE: ClassVar[UInt8] = 0
    RELOCATING: ClassVar[UInt8] = 1

    object_id: UInt32
    name: String = ""
    x: FiniteFloat64 = 0.0
    y: FiniteFloat64 = 0.0
    covariance: Covariance2 = zeros(4)
    reliability: Probability = 1.0
    state: Annotated[int, Scalar("uint8", at_most=1)] = 0
    evidence_count: UInt32 = 0
    candidate_x: Float64 = NAN
    candidate_y: Float64 = NAN
    candidate_reliability: Probability = 0.0

    def __post_init__(self) -> None:
        """Check that a candidate has both coordinates or none."""
        _require_position_or_none(self, "candidate", self.candidate_x, self.candidate_y)


@message("cairn_msgs/msg/VisualMap")
class VisualMap:
    """All objects of the visual map; `version` counts the changes."""

    header: Header = Header()
    version: UInt64 = 0
    objects: tuple[VisualObject, ...] = ()


@message("cairn_msgs/msg/VisualMapChange")
class VisualMapChange:
    """One change of the visual map: the object's position [m] before and after; NaN if none."""

    IMPORTED: ClassVar[UInt8] = 0
    REMOVED: ClassVar[UInt8] = 1
    REGISTERED: ClassVar[UInt8] = 2
    REFINED: ClassVar[UInt8] = 3
    RESTORED: ClassVar[UInt8] = 4

    header: Header = Header()
    version: UInt64 = 0
    object_id: UInt32 = 0
    kind: Annotated[int, Scalar("uint8", at_most=4)] = 0
    old_x: Float64 = NAN
    old_y: Float64 = NAN
    new_x: Float64 = NAN
    new_y: Float64 = NAN
    reliability: Probability = 0.0
    reason: String = ""

    def __post_init__(self) -> None:
        """Check that each position has both coordinates or none."""
        _require_position_or_none(self, "old", self.old_x, self.old_y)
        _require_position_or_none(self, "new", self.new_x, self.new_y)


MOST_CONTRIBUTIONS = 500
"""Most contributions in one message, which then has about 80 kB."""
MOST_CONTRIBUTORS = 256


@message("cairn_msgs/msg/LandmarkContribution")
class LandmarkContribution:
    """What one robot has found out about the present life of a landmark.

    A life is the stay of the object at one position. It began at `began` [ns] by the clock of the
    robot `began_by`, at `x`, `y` [m] with `covariance`; 0, "" and NaN for the life in the map from
    which all robots started. `version` counts the robot's contributions, `stamp` [ns] is the time
    of its newest evidence, by its clock. `removed`: the object is no longer there. `log_odds` is
    the sum of its evidence; `information` is what its observations add to the position: the matrix
    xx, xy, yy [1/m^2], and the vector x, y [1/m] relative to where the life began.
    """

    robot: RobotId
    object_id: UInt32
    version: UInt64
    stamp: UInt64 = 0
    began: UInt64 = 0
    began_by: RobotId = ""
    x: Float64 = NAN
    y: Float64 = NAN
    covariance: Covariance2 = zeros(4)
    removed: Bool = False
    log_odds: FiniteFloat64 = 0.0
    information: Information2 = zeros(5)

    def __post_init__(self) -> None:
        """Check that the position has both coordinates or none."""
        _require_position_or_none(self, "", self.x, self.y)


@message("cairn_msgs/msg/RecordContributor")
class RecordContributor:
    """What a record has of one robot: how many contributions, the newest version, their digest."""

    robot: RobotId
    newest: UInt64 = 0
    count: UInt32 = 0
    digest: UInt64 = 0


@message("cairn_msgs/msg/SharedLandmarks")
class SharedLandmarks:
    """What a robot knows of the landmarks that it shares with robots that have the same map.

    `map` is the digest of the map from which all of them started, `map_version` and `landmarks` are
    the version of the sender's visual map and the number of landmarks in it. `contributors` is all
    that it knows, in short; `contributions` is a part of it. `rejected` counts the contributions
    that it did not accept.
    """

    header: Header = Header()
    robot: RobotId = ""
    map: Annotated[str, Text(most=64)] = ""
    map_version: UInt64 = 0
    landmarks: UInt32 = 0
    rejected: UInt64 = 0
    contributors: tuple[RecordContributor, ...] = ()
    contributions: tuple[LandmarkContribution, ...] = ()

    def __post_init__(self) -> None:
        """Check that there are not too many contributions."""
        for name, held, most in (
            ("contributors", self.contributors, MOST_CONTRIBUTORS),
            ("contributions", self.contributions, MOST_CONTRIBUTIONS),
        ):
            if len(held) > most:
                reject(self, name, len(held), f"must be at most {most}")


MOST_DECISIONS = 64
"""Most decisions in one message, which then has about 8 kB."""


@message("cairn_msgs/msg/CellDecision")
class CellDecision:
    """What one robot has decided at `stamp` [ns] by its clock about some cells of a grid map.

    A tile has 16 x 16 cells; tiles are numbered row by row from the map's origin, and so are the
    cells of a tile: cell n is bit n % 8 (1, 2, 4, ...) of byte n / 8. Each cell is in one of the
    sets `free`, `occupied` and `unknown`, or in none, if the decision is not about it.
    """

    robot: RobotId
    tile: UInt32
    stamp: UInt64
    free: CellSet = zeros(32, np.uint8)
    occupied: CellSet = zeros(32, np.uint8)
    unknown: CellSet = zeros(32, np.uint8)


@message("cairn_msgs/msg/SharedCells")
class SharedCells:
    """What a robot knows of the grid map that it shares with robots that have the same map.

    `map` is the digest of the map from which all of them started, `cells` the number of cells that
    differ from it in the sender's map. `x`, `y` [m] is the sender's position in the map, NaN if it
    is not known, and `radius` [m] its size: others do not put it into their maps. `contributors`,
    `decisions` and `rejected` are as in `SharedLandmarks`.
    """

    header: Header = Header()
    robot: RobotId = ""
    map: Annotated[str, Text(most=64)] = ""
    cells: UInt32 = 0
    rejected: UInt64 = 0
    x: Float64 = NAN
    y: Float64 = NAN
    radius: NotNegative = 0.0
    contributors: tuple[RecordContributor, ...] = ()
    decisions: tuple[CellDecision, ...] = ()

    def __post_init__(self) -> None:
        """Check that there are not too many decisions."""
        _require_position_or_none(self, "", self.x, self.y)
        for name, held, most in (
            ("contributors", self.contributors, MOST_CONTRIBUTORS),
            ("decisions", self.decisions, MOST_DECISIONS),
        ):
            if len(held) > most:
                reject(self, name, len(held), f"must be at most {most}")


@message("cairn_msgs/msg/ObjectProposal")
class ObjectProposal:
    """A thing that was never taught, and that the robot proposes as a new landmark.

    `x`, `y` [m] with `covariance` is its position in frame map, `width`, `height` [m] its size;
    `seen` counts how often it was recognized, since `first`. `picture` is a small JPEG image.
    """

    number: UInt32
    name: String = ""
    x: FiniteFloat64 = 0.0
    y: FiniteFloat64 = 0.0
    covariance: Covariance2 = zeros(4)
    width: Distance = 1.0
    height: Distance = 1.0
    seen: UInt32 = 0
    first: Time = Time()
    picture: UInt8Array = empty(np.uint8)


@message("cairn_msgs/msg/ObjectProposals")
class ObjectProposals:
    """All things that wait to be accepted as landmarks, or rejected."""

    header: Header = Header()
    proposals: tuple[ObjectProposal, ...] = ()


@message("cairn_msgs/msg/PortStatus")
class PortStatus:
    """The messages or calls of one port of a component since it was configured.

    `topic` is also the name of a service. `messages` were handled, published, served or called;
    `dropped` were lost on the way or in favor of newer ones; `invalid` broke their definition or a
    limit; `refused` came to an exclusive port from a publisher that is not entitled, or to a server
    for which too many calls waited.
    """

    IN: ClassVar[UInt8] = 0
    OUT: ClassVar[UInt8] = 1
    SERVER: ClassVar[UInt8] = 2
    CLIENT: ClassVar[UInt8] = 3

    port: String
    topic: String
    direction: Annotated[int, Scalar("uint8", at_most=3)]
    messages: UInt64 = 0
    dropped: UInt64 = 0
    invalid: UInt64 = 0
    refused: UInt64 = 0


@message("cairn_msgs/msg/ComponentStatus")
class ComponentStatus:
    """The state of one component.

    `parent` is "" for the root; `handler` is the handler that has been running for `handler_s` [s],
    "" when none is; `reason` says why the component is in this state, or why it was restarted;
    `children` names the components that a supervisor may load. `machine` is "" on a robot with one
    computer.
    """

    header: Header
    component: String
    machine: String = ""
    plugin: String = ""
    parent: String = ""
    placement: String = ""
    state: Annotated[
        str, Text(one_of=("unconfigured", "inactive", "active", "finalized", "error"))
    ] = "unconfigured"
    pid: UInt32 = 0
    handler: String = ""
    handler_s: NotNegative = 0.0
    restarts: UInt32 = 0
    reason: String = ""
    children: tuple[String, ...] = ()
    ports: tuple[PortStatus, ...] = ()


MACHINE_STATUS: Final = "machine_status"
"""The topic, below its own name, on which the root of each of a robot's machines publishes."""


@message("cairn_msgs/msg/MachineChild")
class MachineChild:
    """A component that the root of a machine starts, as `cairn.processes.child` describes it."""

    name: String
    state: String = ""
    incarnation: UInt32 = 0
    reason: String = ""


@message("cairn_msgs/msg/MachineLink")
class MachineLink:
    """How a machine sees another one of its robot.

    It has received nothing from it for `silent_s` [s]. While it counts as lost, `components` names
    what runs there and `inputs` what is missing here, such as
    `/robot/localization (localizer) for motion_control`. `last_sent` is the stamp of the last
    status received from it, on its clock, and `last_received` when that was, on the clock here:
    from them the other one measures how far its clock is off. The clock there is `clock_offset` [s]
    ahead of the one here, within `clock_error` [s]; NaN: not known yet.
    """

    machine: String
    is_up: Bool = False
    silent_s: NotNegative = 0.0
    last_sent: Time = Time()
    last_received: Time = Time()
    clock_offset: Float64 = NAN
    clock_error: Float64 = NAN
    components: tuple[String, ...] = ()
    inputs: tuple[String, ...] = ()


@message("cairn_msgs/msg/MachineStatus")
class MachineStatus:
    """What the root of one machine of a robot publishes four times a second.

    The header has its system time; `children` are the components that it starts itself, `links` the
    other machines as it sees them.
    """

    header: Header
    machine: String
    children: tuple[MachineChild, ...] = ()
    links: tuple[MachineLink, ...] = ()


@message("cairn_msgs/msg/CallBatch")
class CallBatch:
    """A part of a component's call log: what it was called with, read and published.

    `incarnation` counts the component's starts, and this one was at `started`. `records` holds
    `count` records, of which the first has the number `first`; `cairn.runtime.call_records` defines
    them.
    """

    header: Header
    component: String
    incarnation: UInt32
    started: Time
    first: UInt64
    count: UInt32
    records: UInt8Array = empty(np.uint8)


def _require_position_or_none(message: object, name: str, x: float, y: float) -> None:
    if isinf(x) or isinf(y) or isnan(x) != isnan(y):
        names = f"{name}_x, {name}_y" if name else "x, y"
        reject(message, names, (x, y), "must be two finite numbers, or NaN twice")
