"""World and drivers together on virtual time, driven by a script."""

from pathlib import Path
from typing import Any

import yaml

from cairn import LATCHED, SECOND, SENSOR, Component, to_ns
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
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.tf2_msgs import TFMessage
from tests.cairn.runtime.running import Lockstep, Placed, taken
from tests.components.simulation.worlds import box

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
    """The world of `more` and its drivers, driven by a script."""

    def __init__(self, folder: Path, exact: bool = True, **more: Any) -> None:
        self.file = folder / "world.yaml"
        self.file.write_text(yaml.safe_dump(box(**more)))
        self.lockstep = Lockstep()
        self.lockstep.run_until(SECOND)
        topics = {
            "odom": Odometry,
            "truth": PoseStamped,
            "scan": LaserScan,
            "objects": RecognizedObjectArray,
            "collisions": Collision,
            "world_state": WorldState,
            "tf": TFMessage,
        }
        self._readers = {name: self.lockstep.read(name, kind) for name, kind in topics.items()}
        self._readers["tf_static"] = self.lockstep.read("tf_static", TFMessage, qos=LATCHED)
        slip = {"slip": NO_SLIP} if exact else {}
        self.world = self._add(SimulatedWorld, world=str(self.file), **slip)
        self.base = self._add(SimulatedBase, **(EXACT if exact else {}))
        self.scanner = self._add(SimulatedScanner, mount=MOUNT, rate=10, dropouts=0)
        self.recognizer = self._add(
            SimulatedRecognizer, detection_probability=1.0, confusion_probability=0.0
        )
        self.now = SECOND

    def drive(self, seconds: float, forward: float, turn: float) -> None:
        """Command these speeds for some seconds."""
        for _ in range(round(seconds * 10)):
            command = Twist(linear=Vector3(x=forward), angular=Vector3(z=turn))
            self.lockstep.publish("cmd_vel", command, qos=SENSOR)
            self.now += SECOND // 10
            self.lockstep.run_until(self.now)

    def taken(self, topic: str) -> list[Any]:
        """The messages published since the last call."""
        return taken(self._readers[topic])

    def rerun(self, kind: type[Component], **parameters: Any) -> Placed[Any]:
        return self._add(kind, **parameters)

    def _add(self, kind: type[Component], **parameters: Any) -> Placed[Any]:
        part = self.lockstep.add(kind, name=kind.__name__.lower(), parameters=parameters)
        part.activate()
        return part


def poses_of(messages: list[Any]) -> dict[int, Pose]:
    return {
        to_ns(m.header.stamp): planar_pose(m.pose if isinstance(m, PoseStamped) else m.pose.pose)
        for m in messages
    }


def script(simulation: Simulation) -> None:
    simulation.drive(2.0, 0.4, 0.0)
    simulation.drive(2.0, 0.0, 1.5)
    simulation.drive(2.0, 0.3, -0.8)
    simulation.drive(1.0, 0.0, 0.0)
