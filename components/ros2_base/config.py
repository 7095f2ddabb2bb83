"""Parameters of a base behind ROS 2."""

from __future__ import annotations

from pydantic import Field

from cairn import Config


class Ros2BaseConfig(Config):
    """A base that another program drives."""

    stamped: bool = Field(
        False,
        description="Send geometry_msgs/TwistStamped on base_cmd_vel_stamped instead of Twist on "
        "base_cmd_vel, as diff_drive_controller takes it since Jazzy.",
    )
    speed: float = Field(0.6, gt=0, le=5, description="Fastest that is sent on [m/s].")
    turn: float = Field(1.5, gt=0, le=10, description="Fastest turn that is sent on [rad/s].")
    command_timeout_s: float = Field(
        0.3, gt=0, le=5, description="Age of a command after which the base is told to rest [s]."
    )
    rest_s: float = Field(
        1.0, gt=0, le=3600, description="How long it is told so, before nothing is sent [s]."
    )
    odom_frame: str = Field("odom", description="Frame of the base's odometry.")
    base_frame: str = Field("base_link", description="The robot's frame in the base's odometry.")
    odom_rate: float = Field(
        20.0, gt=0, le=1000, description="How often the base tells odometry, nominally [Hz]."
    )
    odom_timeout_s: float = Field(
        0.5, gt=0, le=10, description="Silence of the odometry after which it is not driven [s]."
    )
    odom_age_s: float = Field(
        0.5, gt=0, le=10, description="Age beyond which odometry is thrown away [s]."
    )
    stamp_on_arrival: bool = Field(
        False, description="Stamp odometry when it comes, for a base whose clock is not set."
    )
    send_tf: bool = Field(
        True, description="Send the transform odom to base_link; else the base does."
    )
