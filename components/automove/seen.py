"""What AutoMove knows of the robot: the last that the other components told."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from cairn.components.automove.trail import Trail
from cairn.planar.poses import Pose
from cairn.schemas.cairn_nav_msgs import LocalizationHealth, MotionStatus, Plan


@dataclass
class Seen:
    """The last that the other components told, and when [s]; None before the first."""

    health: LocalizationHealth | None = None
    health_s: float = -math.inf
    plan: Plan | None = None
    motion: MotionStatus | None = None
    motion_s: float = -math.inf
    pose: Pose | None = None
    trail: Trail = field(default_factory=Trail)

    def note_pose(self, pose: Pose) -> None:
        """Note where the robot is, and where it came from."""
        self.pose = pose
        self.trail.note(pose)
