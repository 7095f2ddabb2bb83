"""Components of a small robot, with enough ports and parameters for every mistake."""

from typing import ClassVar, Literal

from pydantic import Field, field_validator

from cairn import Component, Config, In, Out, on
from cairn.schemas.geometry_msgs import Twist
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.sensor_msgs import LaserScan


class Supervisor(Component):
    """Supervises the parts."""

    is_supervisor: ClassVar[bool] = True


class ScannerConfig(Config):
    device: str = Field(description="Serial device.", min_length=1)
    rate: float = Field(10.0, gt=0, le=40, description="Scans per second [Hz].")


class Scanner(Component):
    """Reads a laser scanner."""

    config: ScannerConfig
    scan: Out[LaserScan]


class Base(Component):
    """Drives the wheels.

    Stops them when commands go stale.
    """

    command: In[Twist] = In(optional=True)
    odom: Out[Odometry]


class Wheels(Component):
    """Follows the odometry of one base."""

    command: In[Odometry] = In(exclusive=True)


class Driver(Component):
    """Alone drives wheels that are outside the deployment."""

    wheels: Out[Odometry] = Out(exclusive=True)


class FilterConfig(Config):
    sigma: float = Field(0.1, gt=0, le=1, description="Noise of a beam [m].")


class LocalizerConfig(Config):
    particles: int = Field(500, ge=10, le=200_000, description="Number of particles [1].")
    filter: FilterConfig = Field(default_factory=FilterConfig, description="Sensor model.")
    gains: tuple[float, float] = Field((1.0, 2.0), description="Gains [1].")
    map_file: str = Field("", description="Map to start with.")

    @field_validator("map_file")
    @classmethod
    def _no_bitmap(cls, file: str) -> str:
        if file.endswith(".bmp"):
            raise KeyError(file)
        return file


class Localizer(Component):
    """Estimates the robot's pose in the map."""

    config: LocalizerConfig
    odom: In[Odometry]
    scan: In[LaserScan]


class Simulator(Component):
    """Publishes time, scans and odometry."""

    clock_source: ClassVar[Literal["deployment", "system"]] = "system"
    time: Out[Clock]
    scan: Out[LaserScan]


class WaitingSimulator(Component):
    """Publishes the simulated time that it uses itself."""

    time: Out[Clock]


class ScannerDriver(Component):
    """Drives a scanner."""

    clock_source: ClassVar[Literal["deployment", "system", "device"]] = "device"
    scan: Out[LaserScan]


class Listener(Component):
    """Has a handler of a port that does not exist."""

    @on("odm")
    def listen(self, odom: Odometry) -> None:
        """Never called."""
