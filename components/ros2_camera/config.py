"""Parameters of a camera or stereo camera behind ROS 2."""

from __future__ import annotations

from pydantic import Field

from cairn import Config, SensorFrame


class Ros2StereoCameraConfig(Config):
    """A camera or stereo camera whose nodes publish images with `sensor_msgs/CameraInfo`."""

    stereo: bool = Field(True, description="There is a right camera.")
    compressed: bool = Field(
        False,
        description="The nodes' images are read from source_left_compressed and "
        "source_right_compressed (sensor_msgs/CompressedImage: JPEG, PNG).",
    )
    mount_frame: SensorFrame = Field(
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
