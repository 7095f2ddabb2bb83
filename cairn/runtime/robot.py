"""The section `robot` of a deployment: its name, shape, drive, limits and mounts.

Components take their defaults from it: see `cairn.deployment.robot_defaults`.
"""

from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, Field

from cairn.runtime.child_spec import Name, Section

FrameName = Annotated[str, Field(pattern=r"^[a-zA-Z_][a-zA-Z0-9_]*$")]


def _quantity(limit: float, description: str) -> Any:
    return Field(None, gt=0, le=limit, allow_inf_nan=False, description=description)


class Shape(Section):
    """The robot's outline, around the center of its base: a circle."""

    radius_m: float | None = _quantity(5, "Radius: half of its largest width [m].")


class Drive(Section):
    """How the robot moves: two wheels that are driven, on one axis."""

    kind: Literal["differential"] = Field("differential", description="Kind of the drive.")
    wheel_radius_m: float | None = _quantity(1, "Radius of the left wheel [m].")
    wheel_separation_m: float | None = _quantity(
        3, "Distance of the points where the wheels touch the floor [m]."
    )


class Limits(Section):
    """The highest speeds and accelerations of the robot."""

    speed_m_s: float | None = _quantity(5, "Highest speed ahead [m/s].")
    reverse_speed_m_s: float | None = _quantity(5, "Highest speed backward [m/s].")
    turn_rad_s: float | None = _quantity(10, "Highest turn rate [rad/s].")
    acceleration_m_s2: float | None = _quantity(20, "Highest acceleration [m/s^2].")
    turn_acceleration_rad_s2: float | None = _quantity(
        50, "Highest angular acceleration [rad/s^2]."
    )


class Mounts(Section):
    """The frames in which the robot's sensors are mounted."""

    scanner: FrameName = Field("laser", description="Frame of the range scanner.")
    camera: FrameName = Field("camera", description="Frame of the camera, of two the left one.")


class Robot(Section):
    """The robot: what its components have in common, as far as it is given."""

    name: Name = Field("robot", description="Namespace of every name on the bus.")
    shape: Shape = Field(default_factory=Shape, description="Its outline.")
    drive: Drive = Field(default_factory=Drive, description="How it moves.")
    limits: Limits = Field(default_factory=Limits, description="Its highest speeds.")
    mounts: Mounts = Field(default_factory=Mounts, description="Frames of its sensors.")


def _with_keys(value: Any) -> Any:
    return {"name": value} if isinstance(value, str) else value


RobotOrName = Annotated[Robot, BeforeValidator(_with_keys, json_schema_input_type=Name | Robot)]
"""The robot, or only its name."""

QUANTITIES: Final = frozenset(
    {
        *(
            f"{section}.{name}"
            for section, model in (("shape", Shape), ("drive", Drive), ("limits", Limits))
            for name in model.model_fields
        ),
        *(
            f"mounts.{sensor}{what}"
            for sensor in Mounts.model_fields
            for what in ("", ".z", ".frame")
        ),
    }
)
"""What a parameter can have by default: numbers of the robot, and of the frame of each sensor its
pose in the plane, its height `z` [m] and its name `frame`."""
