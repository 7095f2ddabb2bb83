"""What the sensors' drivers know of the world: what stands, who walks, where the robot is."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND, to_ns
from cairn.components.simulation.recognition import Thing
from cairn.components.simulation.scanning import Surroundings
from cairn.planar.messages import planar_pose, planar_poses
from cairn.planar.poses import Pose, compose
from cairn.schemas.cairn_sim_msgs import Scene, WorldState

Array = NDArray[np.float64]

_KEPT = 100
# The robot is taken to go on as it did for so long [s] after it was last heard of.
_GOES_ON_S = 0.1


class WorldWatch:
    """The newest scene and the states of the last two seconds."""

    def __init__(self) -> None:
        self._states: deque[tuple[int, Pose]] = deque(maxlen=_KEPT)
        self._speeds = (0.0, 0.0)
        self._people = np.zeros((0, 3))
        self._segments = np.zeros((0, 4))
        self._surfaces = np.zeros(0, np.uint8)
        self._scene_known = False
        self.things: list[Thing] = []

    def take_scene(self, scene: Scene) -> None:
        """Take what stands."""
        self._scene_known = True
        self._segments = np.array(scene.segments).reshape(-1, 4)
        self._surfaces = np.array(scene.surfaces)
        poses = planar_poses(scene.object_poses).tolist()
        self.things = [
            Thing(int(object_id), (x, y, theta))
            for object_id, (x, y, theta) in zip(scene.object_ids, poses, strict=True)
        ]

    def take_state(self, state: WorldState) -> None:
        """Take what moves."""
        stamp = to_ns(state.header.stamp)
        if self._states and stamp < self._states[-1][0]:
            self._states.clear()
        self._states.append((stamp, planar_pose(state.robot)))
        self._speeds = (state.forward, state.turn)
        self._people = np.array(state.people.array)

    @property
    def around(self) -> Surroundings:
        """What rays may meet now."""
        return Surroundings(self._segments, self._surfaces, self._people)

    def robot_at(self, began: int, times: Array) -> Array | None:
        """Poses (n, 3) of the robot at rising `times` (n,) [s] after `began` [ns].

        After the newest state the robot is presumed to go on for a moment. None if nothing is
        known of it, or of what stands.
        """
        if not self._scene_known or not self._states:
            return None
        known: list[tuple[float, Pose]] = []
        for stamp, pose in reversed(self._states):
            known.append(((stamp - began) / SECOND, pose))
            if stamp <= began:
                break
        known.reverse()
        newest, pose = known[-1]
        ahead_s = min(float(times[-1]) - newest, _GOES_ON_S)
        if ahead_s > 0.0:
            known.append((newest + ahead_s, self._gone_on(pose, ahead_s)))
        stamps = np.array([stamp for stamp, _ in known])
        poses = np.array([pose for _, pose in known])
        poses[:, 2] = np.unwrap(poses[:, 2])
        return np.column_stack([np.interp(times, stamps, column) for column in poses.T])

    def _gone_on(self, pose: Pose, seconds: float) -> Pose:
        forward, turn = self._speeds
        half = (0.0, 0.0, 0.5 * turn * seconds)
        return compose(compose(compose(pose, half), (forward * seconds, 0.0, 0.0)), half)


def composed(poses: Array, mount: Pose) -> Array:
    """The poses (n, 3) of a sensor that sits at `mount` on a robot with the poses (n, 3)."""
    x, y, theta = mount
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    steps = np.column_stack(
        (cosine * x - sine * y, sine * x + cosine * y, np.full(len(poses), theta))
    )
    there: Array = poses + steps
    return there
