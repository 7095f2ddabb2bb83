"""Parameters of the driver of the PBS-03JN."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field

from cairn import Config, FromRobot, SensorFrame
from cairn.driver.device_names import SerialPort


class PbsConfig(Config):
    """Where the sensor is connected, and the directions of its rays.

    Public sources disagree about the angle between rays: 1.8 degrees (sellers, 217.8 degrees in
    all) or 360/204 (Player's driver, 211.8 degrees).
    """

    port: SerialPort = Field(
        description="Serial port: /dev/serial/by-id/..., /dev/ttyUSB0, or usb:VENDOR:PRODUCT"
        "[:SERIAL] with hexadecimal numbers."
    )
    data_bits: Literal[7, 8] = Field(7, description="Data bits on the line; the sensor has 7 [1].")
    frame_id: Annotated[SensorFrame, FromRobot("mounts.scanner.frame")] = Field(
        "laser", description="Frame of the scans."
    )
    resolution: float = Field(
        math.radians(1.8),
        ge=math.radians(1.7),
        le=math.radians(1.85),
        description="Angle between two rays; the middle one is ahead [rad].",
    )
    range_max: float = Field(
        3.0, ge=0.3, le=10, description="Farther ranges count as nothing hit [m]."
    )
    rate: float = Field(
        10.0, ge=0.5, le=12, description="Most requests of distances per second [1/s]."
    )
    time_offset_s: float = Field(0.0, ge=-1, le=1, description="Added to the stamps of scans [s].")
    rate_tolerance: float = Field(
        0.1,
        gt=0,
        le=1,
        description="Share of the rate, off by which diagnostics warn [1].",
    )
