"""Parameters of a range scanner behind ROS 2."""

from __future__ import annotations

from pydantic import Field

from cairn import Config, SensorFrame


class Ros2ScannerConfig(Config):
    """A range scanner whose node publishes `sensor_msgs/LaserScan`."""

    source_frame: str = Field("laser", min_length=1, description="Frame of the node's scans.")
    frame_id: SensorFrame = Field("laser", description="Frame of the scans that are published.")
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
