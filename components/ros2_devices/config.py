"""Parameters of a base, a range scanner and cameras behind ROS 2."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from cairn import Config, FromRobot, SensorFrame


class Ros2BaseConfig(Config):
    """A base that a ROS 2 node drives."""

    stamped: bool = Field(
        False,
        description="Send geometry_msgs/TwistStamped on base_cmd_vel_stamped instead of Twist on "
        "base_cmd_vel, as diff_drive_controller requires since Jazzy.",
    )
    speed: Annotated[float, FromRobot("limits.speed_m_s")] = Field(
        0.6, gt=0, le=5, description="Highest speed sent to the base [m/s]."
    )
    turn: Annotated[float, FromRobot("limits.turn_rad_s")] = Field(
        1.5, gt=0, le=10, description="Highest turn rate sent to the base [rad/s]."
    )
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


class Ros2ScannerConfig(Config):
    """A range scanner whose node publishes `sensor_msgs/LaserScan`."""

    source_frame: str = Field("laser", min_length=1, description="Frame of the node's scans.")
    frame_id: Annotated[SensorFrame, FromRobot("mounts.scanner.frame")] = Field(
        "laser", description="Frame of the scans that are published."
    )
    upside_down: bool = Field(
        False, description="The scanner is mounted upside down: its beams turn to the right."
    )
    rate: float = Field(10.0, gt=0, le=1000, description="Nominal rate of the scans [Hz].")
    timeout_s: float = Field(
        0.5, gt=0, le=10, description="Silence of the node after which it is reported [s]."
    )
    age_s: float = Field(0.5, gt=0, le=10, description="Age beyond which a scan is dropped [s].")
    stamp_on_arrival: bool = Field(
        False, description="Stamp scans on arrival, for a node whose clock is not set."
    )
    time_offset_s: float = Field(0.0, ge=-1, le=1, description="Added to the stamps of scans [s].")


class Ros2StereoCameraConfig(Config):
    """A camera or stereo camera whose nodes publish images with `sensor_msgs/CameraInfo`."""

    stereo: bool = Field(True, description="There is a right camera.")
    compressed: bool = Field(
        False,
        description="The nodes' images are read from source_left_compressed and "
        "source_right_compressed (sensor_msgs/CompressedImage: JPEG, PNG).",
    )
    mount_frame: Annotated[SensorFrame, FromRobot("mounts.camera.frame")] = Field(
        "camera",
        description="Frame on the robot at the left camera, which looks along its x axis; the "
        "optical frames are published in it.",
    )
    rate: float = Field(10.0, gt=0, le=1000, description="Nominal rate of the images [Hz].")
    timeout_s: float = Field(
        2.0, gt=0, le=60, description="Silence of a camera after which it is reported [s]."
    )
    age_s: float = Field(0.5, gt=0, le=10, description="Age beyond which an image is dropped [s].")
    stamp_on_arrival: bool = Field(
        False, description="Stamp images on arrival, for nodes whose clock is not set."
    )
