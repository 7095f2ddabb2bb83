"""Parameters of a base behind ROS 2."""

from __future__ import annotations

from pydantic import Field

from cairn import Config


class Ros2BaseConfig(Config):
    """A base that a ROS 2 node drives."""

    stamped: bool = Field(
        False,
        description="Send geometry_msgs/TwistStamped on base_cmd_vel_stamped instead of Twist on "
        "base_cmd_vel, as diff_drive_controller requires since Jazzy.",
    )
    speed: float = Field(0.6, gt=0, le=5, description="Highest speed sent to the base [m/s].")
    turn: float = Field(1.5, gt=0, le=10, description="Highest turn rate sent to the base [rad/s].")
    command_timeout_s: float = Field(
        0.3,
        gt=0,
        le=5,
        description="Age of a command after which rest is sent to the base [s].",
    )
    rest_s: float = Field(
        1.0, gt=0, le=3600, description="How long rest is sent, before nothing is sent [s]."
    )
    odom_frame: str = Field("odom", description="Frame of the base's odometry.")
    base_frame: str = Field("base_link", description="The robot's frame in the base's odometry.")
    odom_rate: float = Field(
        20.0, gt=0, le=1000, description="Nominal rate of the base's odometry [Hz]."
    )
    odom_timeout_s: float = Field(
        0.5,
        gt=0,
        le=10,
        description="Silence of odometry after which the base is not driven [s].",
    )
    odom_age_s: float = Field(
        0.5, gt=0, le=10, description="Age beyond which odometry is dropped [s]."
    )
    stamp_on_arrival: bool = Field(
        False, description="Stamp odometry on arrival, for a base whose clock is not set."
    )
    send_tf: bool = Field(
        True,
        description="Publish the transform odom to base_link; set it to false if the base does.",
    )
