"""Parameters of the driver of SCIP scanners."""

from __future__ import annotations

import math
from typing import Annotated, Self

from pydantic import Field, model_validator

from cairn import Config, FromRobot, SensorFrame
from cairn.components.hokuyo_scanner.client import BAUDS
from cairn.components.hokuyo_scanner.messages import Echo
from cairn.components.hokuyo_scanner.protocol import Encoding
from cairn.driver.device_names import NamesHost, SerialPort


class HokuyoConfig(Config):
    """Where the sensor is connected, and what it measures.

    Those of `LIVE` may be changed while it runs.
    """

    port: SerialPort | None = Field(
        None,
        description="Serial port: /dev/serial/by-id/..., /dev/ttyACM0, or usb:VENDOR:PRODUCT"
        "[:SERIAL] with hexadecimal numbers. Either this or host.",
    )
    baud: int = Field(
        115200,
        ge=19200,
        le=750000,
        description="Speed of an RS-232 line; a sensor with another speed is found and set "
        "to this one; no effect over USB [bit/s].",
    )
    host: Annotated[str, NamesHost("tcp_port")] | None = Field(
        None, description="Address of a sensor on Ethernet, as 192.168.0.10. Either this or port."
    )
    tcp_port: int = Field(10940, ge=1, le=65535, description="Its TCP port [1].")
    frame_id: Annotated[SensorFrame, FromRobot("mounts.scanner.frame")] = Field(
        "laser", description="Frame of the scans."
    )
    angle_min: float = Field(
        -math.pi, ge=-math.pi, le=math.pi, description="Direction of the first ray, at least [rad]."
    )
    angle_max: float = Field(
        math.pi, ge=-math.pi, le=math.pi, description="Direction of the last ray, at most [rad]."
    )
    cluster: int = Field(
        1,
        ge=1,
        le=99,
        description="How many neighboring rays become one range, the nearest of them [1].",
    )
    skip: int = Field(0, ge=0, le=9, description="Scans to skip after each one [1].")
    intensity: bool = Field(
        False,
        description="Request intensities, if the sensor has them; scans are twice as long.",
    )
    multi_echo: bool = Field(
        False, description="Request up to three echoes of a ray, if the sensor has them."
    )
    echo: Echo = Field(
        "first",
        description="Which of several echoes is the range in `scan`; without intensities "
        "`strongest` is the last one.",
    )
    short_distances: bool = Field(
        False, description="Two characters per distance: a third less on the line, up to 4.095 m."
    )
    range_max: float | None = Field(
        None,
        gt=0,
        le=262,
        description="Farther ranges count as nothing hit [m]; null: the limit that the sensor "
        "reports.",
    )
    calibrate_time: bool = Field(
        True, description="Read the sensor's clock each time it starts: 0.1 s, its laser off."
    )
    time_offset_s: float = Field(0.0, ge=-1, le=1, description="Added to the stamps of scans [s].")
    silence_s: float = Field(
        0.5,
        ge=0.05,
        le=60,
        description="How long nothing is received, beyond two turns, until the sensor is started "
        "again [s].",
    )
    rate_tolerance: float = Field(
        0.05,
        gt=0,
        le=1,
        description="Deviation from the nominal rate, as a share, at which diagnostics warn [1].",
    )

    @model_validator(mode="after")
    def _agree(self) -> Self:
        if (self.port is None) == (self.host is None):
            raise ValueError("set either port, for a serial line or USB, or host, for Ethernet")
        if self.baud not in BAUDS:
            raise ValueError(f"baud must be one of {', '.join(map(str, sorted(BAUDS)))}")
        if self.angle_min >= self.angle_max:
            raise ValueError("angle_min must be less than angle_max")
        if self.short_distances and (self.intensity or self.multi_echo):
            raise ValueError("short_distances cannot be combined with intensity or multi_echo")
        return self

    @property
    def encoding(self) -> Encoding:
        """Characters per distance."""
        return 2 if self.short_distances else 3


LIVE = (
    "angle_min",
    "angle_max",
    "cluster",
    "skip",
    "intensity",
    "multi_echo",
    "echo",
    "short_distances",
    "range_max",
    "time_offset_s",
    "silence_s",
    "rate_tolerance",
)
"""Parameters that may be changed while the sensor runs; its stream starts again then."""
