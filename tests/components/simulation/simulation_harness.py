"""The simulated world and its drivers in virtual time; the test commands the robot."""

from pathlib import Path
from typing import Any, TypeVar

import yaml

from cairn import SECOND, SENSOR, Component, from_ns, to_ns
from cairn.components.simulation.base import SimulatedBase
from cairn.components.simulation.recognizer import SimulatedRecognizer
from cairn.components.simulation.scanner import SimulatedScanner
from cairn.components.simulation.world_component import SimulatedWorld
from cairn.planar.messages import planar_pose
from cairn.planar.poses import Pose
from cairn.schemas.cairn_msgs import RecognizedObjectArray
from cairn.schemas.cairn_nav_msgs import Collision
from cairn.schemas.cairn_sim_msgs import WorldState
from cairn.schemas.geometry_msgs import PoseStamped, Twist, Vector3
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.tf2_msgs import TFMessage
from cairn.testing.lockstep import ComponentHarness, Lockstep
from tests.components.simulation.worlds import box

C = TypeVar("C", bound=Component)

EXACT = {
    "distance_scale_sd": 0,
    "turn_scale_sd": 0,
    "distance_error": 0,
    "turn_error": 0,
    "turn_per_meter": 0,
}
NO_SLIP = {"distance": 0, "turn": 0, "turn_per_meter": 0}
MOUNT = {"x": 0.1, "y": 0.0, "theta": 0.2}
TABLE = {"name": "table", "x": 1.5, "y": 3.0, "theta": 0.3, "size": [0.8, 0.8]}
OBJECTS = [{"id": 1, "x": 6, "y": 2.0, "theta": 3.1416}, {"id": 2, "x": 0, "y": 2.0}]


class Simulation:
    """A simulated world with base, scanner and recognizer; the test commands the robot.

    `world` holds additional entries of the world file; the errors of the base are off if `exact`.
    With `simulated_time` the test sets the clock.
    """

    def __init__(
        self, folder: Path, exact: bool = True, simulated_time: bool = False, **world: Any
    ) -> None:
        self._simulated_time = simulated_time
        self.file = folder / "world.yaml"
        self.file.write_text(yaml.safe_dump(box(**world)))
        self.lockstep = Lockstep(start_s=1.0)
        topics: dict[str, type[Any]] = {
            "odom": Odometry,
            "truth": PoseStamped,
            "scan": LaserScan,
            "objects": RecognizedObjectArray,
            "collisions": Collision,
            "world_state": WorldState,
            "tf": TFMessage,
        }
        self._readings = {name: self.lockstep.read(name, kind) for name, kind in topics.items()}
        slip = {"slip": NO_SLIP} if exact else {}
        self.world = self.add(SimulatedWorld, world=str(self.file), **slip)
        self.base = self.add(SimulatedBase, **(EXACT if exact else {}))
        self.scanner = self.add(SimulatedScanner, mount=MOUNT, rate=10, dropouts=0)
        self.recognizer = self.add(
            SimulatedRecognizer, detection_probability=1.0, confusion_probability=0.0
        )

    def add(self, component: type[C], **parameters: Any) -> ComponentHarness[C]:
        """Add an active component, beside those of its class that run already."""
        name = component.__name__.lower()
        return ComponentHarness(
            component,
            parameters,
            beside=self.lockstep,
            name=name,
            simulated_time=self._simulated_time,
        )

    def drive(self, seconds: float, forward: float, turn: float) -> None:
        """Command these speeds [m/s, rad/s] for some seconds."""
        for _ in range(round(seconds * 10)):
            command = Twist(linear=Vector3(x=forward), angular=Vector3(z=turn))
            self.lockstep.publish("cmd_vel", command, qos=SENSOR)
            self.lockstep.run_for(0.1)

    def set_clock(self, time_s: float) -> None:
        """Set the simulated time [s]."""
        self.lockstep.publish("clock", Clock(clock=from_ns(round(time_s * SECOND))))

    def take(self, topic: str) -> list[Any]:
        """Return the messages published since the last call."""
        return self._readings[topic].take()


def poses_of(messages: list[Any]) -> dict[int, Pose]:
    """Return the poses of messages by their stamps [ns]."""
    return {
        to_ns(m.header.stamp): planar_pose(m.pose if isinstance(m, PoseStamped) else m.pose.pose)
        for m in messages
    }


def drive_curves(simulation: Simulation) -> None:
    """Drive straight, turn in place, drive a curve, and stop: 7 s."""
    simulation.drive(2.0, 0.4, 0.0)
    simulation.drive(2.0, 0.0, 1.5)
    simulation.drive(2.0, 0.3, -0.8)
    simulation.drive(1.0, 0.0, 0.0)
