"""Messages of the simulation: what the drivers of a simulated robot know of its world."""

from typing import Annotated, ClassVar, Final

import numpy as np

from cairn.schemas.field_types import (
    FiniteFloat64,
    Float64Array,
    Scalar,
    String,
    UInt8,
    UInt8Array,
    UInt32Array,
    empty,
)
from cairn.schemas.geometry_msgs import Point, Pose
from cairn.schemas.message import message, reject
from cairn.schemas.packed import Packed
from cairn.schemas.std_msgs import Header


@message("cairn_sim_msgs/msg/WheelMotion")
class WheelMotion:
    """The true motion of the wheels of `robot` for `seconds` [s] until the stamp.

    `forward`, `aside` [m/s] and `turn` [rad/s] are their mean speeds; wheels that slip on a slope
    move the robot sideways, to the left if `aside` is positive.
    """

    header: Header = Header()
    seconds: Annotated[float, Scalar("float64", at_least=0)] = 0.0
    forward: FiniteFloat64 = 0.0
    turn: FiniteFloat64 = 0.0
    aside: FiniteFloat64 = 0.0
    robot: String = ""


@message("cairn_sim_msgs/msg/FurtherRobot")
class FurtherRobot:
    """A further robot in a world: its true pose, radius [m] and speeds [m/s, rad/s]."""

    name: String = ""
    pose: Pose = Pose()
    radius: Annotated[float, Scalar("float64", above=0)] = 0.2
    forward: FiniteFloat64 = 0.0
    turn: FiniteFloat64 = 0.0


@message("cairn_sim_msgs/msg/WorldState")
class WorldState:
    """What moves: the robot's true pose and speeds [m/s, rad/s]; people as x, y, radius [m].

    `radius` [m] is that of the robot, and `others` are further robots in the same world.
    """

    header: Header = Header()
    robot: Pose = Pose()
    forward: FiniteFloat64 = 0.0
    turn: FiniteFloat64 = 0.0
    people: Packed[Point] = Packed(Point)
    radius: Annotated[float, Scalar("float64", above=0)] = 0.2
    others: tuple[FurtherRobot, ...] = ()


MOST_OBJECTS: Final = 100
"""Most objects of a world: the pictures on them take up to 4 MB of a camera's memory each."""


@message("cairn_sim_msgs/msg/WorldGeometry")
class WorldGeometry:
    """What does not move: `segments` x1, y1, x2, y2 [m], four each, `surfaces`, and the objects.

    For cameras each segment has one of `heights` [m], 0 if it is part of an object; `solids`
    numbers closed shapes with a top from 1 on, 0 is a wall. `object_poses` face away from their
    wall; all other `object_...` arrays belong to them: `object_sizes` are width, height [m], two
    each, `object_zs` [m] the heights of the centers, and `object_textures` the files of pictures,
    "" for a picture that is drawn for the id.
    """

    PLAIN: ClassVar[UInt8] = 0
    DARK: ClassVar[UInt8] = 1
    GLASS: ClassVar[UInt8] = 2

    header: Header = Header()
    segments: Float64Array = empty(np.float64)
    surfaces: UInt8Array = empty(np.uint8)
    heights: Float64Array = empty(np.float64)
    solids: UInt32Array = empty(np.uint32)
    object_ids: UInt32Array = empty(np.uint32)
    object_names: tuple[String, ...] = ()
    object_poses: Packed[Pose] = Packed(Pose)
    object_sizes: Float64Array = empty(np.float64)
    object_zs: Float64Array = empty(np.float64)
    object_textures: tuple[String, ...] = ()

    def __post_init__(self) -> None:
        """Check that the lengths agree."""
        if self.segments.size != 4 * self.surfaces.size:
            reject(self, "segments", self.segments, f"must be 4 x {self.surfaces.size} numbers")
        if not self.heights.size == self.solids.size == self.surfaces.size:
            reject(self, "surfaces", self.surfaces, "must be as many as heights and solids")
        objects = self.object_ids.size
        theirs = (self.object_names, self.object_poses, self.object_zs, self.object_textures)
        if any(len(one) != objects for one in theirs) or self.object_sizes.size != 2 * objects:
            reject(
                self,
                "object_ids",
                self.object_ids,
                "must be as many as names, poses, sizes, zs and textures",
            )
        if objects > MOST_OBJECTS:
            reject(self, "object_ids", self.object_ids, f"must be at most {MOST_OBJECTS}")
