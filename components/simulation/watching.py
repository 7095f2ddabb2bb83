"""What the sensors' drivers know of the world: what stands, who walks, where the robot is."""

from __future__ import annotations

from collections import deque

import numpy as np

from cairn.clock import SECOND, to_ns
from components.simulation.recognition import Thing
from components.simulation.scanning import Surroundings
from planar.messages import planar_pose, planar_poses
from planar.poses import Pose, between, compose
from schemas.cairn_sim_msgs import Scene, WorldState

_KEPT = 100
# The world is taken to go on as it did for so long [s] after it was last heard of.
_GOES_ON_S = 0.1


class WorldWatch:
    """The newest scene and the states of the last two seconds."""

    def __init__(self) -> None:
        self._states: deque[tuple[int, Pose, float, float]] = deque(maxlen=_KEPT)
        self._people = np.zeros((0, 3))
        self._segments = np.zeros((0, 4))
        self._surfaces = np.zeros(0, np.uint8)
        self.things: list[Thing] = []
        self.scene_known = False

    def take_scene(self, scene: Scene) -> None:
        """Take what stands."""
        self.scene_known = True
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
        self._states.append((stamp, planar_pose(state.robot), state.forward, state.turn))
        self._people = np.array(state.people.array)

    @property
    def around(self) -> Surroundings:
        """What rays may meet now."""
        return Surroundings(self._segments, self._surfaces, self._people)

    def robot_at(self, stamp: int) -> Pose | None:
        """Where the robot was, or will be presumably, at a time [ns]; None if that is not known."""
        if not self.scene_known or not self._states:
            return None
        newest, pose, forward, turn = self._states[-1]
        ahead_s = (stamp - newest) / SECOND
        if ahead_s >= 0.0:
            ahead_s = min(ahead_s, _GOES_ON_S)
            half = (0.0, 0.0, 0.5 * turn * ahead_s)
            return compose(compose(compose(pose, half), (forward * ahead_s, 0.0, 0.0)), half)
        later = self._states[-1]
        for state in reversed(self._states):
            if state[0] <= stamp:
                share = (stamp - state[0]) / max(1, later[0] - state[0])
                return between(state[1], later[1], share)
            later = state
        return later[1]
