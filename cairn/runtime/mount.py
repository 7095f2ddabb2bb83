"""Where a sensor sits on the robot: a parameter of whoever reads it."""

import math

from pydantic import Field

from cairn.runtime.parameters import Config


class Mount(Config):
    """The pose of a sensor on the robot, in the frame of its base."""

    x: float = Field(0.0, ge=-5, le=5, description="Ahead of the base's center [m].")
    y: float = Field(0.0, ge=-5, le=5, description="Left of it [m].")
    theta: float = Field(0.0, ge=-math.pi, le=math.pi, description="Turned to the left [rad].")

    @property
    def pose(self) -> tuple[float, float, float]:
        """x, y [m], heading [rad]."""
        return self.x, self.y, self.theta
