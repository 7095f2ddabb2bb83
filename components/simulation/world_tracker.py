"""The world as the sensor drivers know it: geometry, people, and the robot's pose over time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND, to_ns
from cairn.components.simulation.layout import SURFACES
from cairn.planar.messages import planar_pose, planar_poses
from cairn.planar.poses import Pose, compose
from cairn.schemas.cairn_sim_msgs import WorldGeometry, WorldState

Array = NDArray[np.float64]

_KEPT_NS = 2 * SECOND  # states
# The robot's motion is extrapolated for at most this long [s] after the newest state.
_EXTRAPOLATED_S = 0.1


@dataclass(frozen=True)
class RayTargets:
    """What rays can hit: segments (m, 4) [m] with surfaces (m,), people (k, 3) x, y, radius [m].

    Other robots are among the people.
    """

    segments: Array
    surfaces: NDArray[np.uint8]
    people: Array

    @property
    def without_glass(self) -> RayTargets:
        """Return the targets without glass."""
        solid = self.surfaces != SURFACES["glass"]
        return RayTargets(self.segments[solid], self.surfaces[solid], self.people)


@dataclass(frozen=True)
class RecognizableObject:
    """A visible object: its id and pose, with the heading that it faces."""

    object_id: int
    pose: Pose


class WorldTracker:
    """The newest geometry and the states of the last two seconds, as the robot `robot` meets them.

    Other robots are people to its sensors. It is the robot of the world file, unless a further one
    has its name.
    """

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._states: deque[tuple[int, Pose]] = deque()
        self._speeds = (0.0, 0.0)
        self._people = np.zeros((0, 3))
        self._segments = np.zeros((0, 4))
        self._surfaces = np.zeros(0, np.uint8)
        self._geometry_known = False
        self.objects: list[RecognizableObject] = []

    def update_geometry(self, geometry: WorldGeometry) -> None:
        """Take walls, furniture and objects."""
        self._geometry_known = True
        self._segments = np.array(geometry.segments).reshape(-1, 4)
        self._surfaces = np.array(geometry.surfaces)
        poses = planar_poses(geometry.object_poses).tolist()
        self.objects = [
            RecognizableObject(int(object_id), (x, y, theta))
            for object_id, (x, y, theta) in zip(geometry.object_ids, poses, strict=True)
        ]

    def update_state(self, state: WorldState) -> None:
        """Take the poses of robot and people."""
        stamp = to_ns(state.header.stamp)
        if self._states and stamp < self._states[-1][0]:
            self._states.clear()
        while self._states and not stamp - _KEPT_NS < self._states[0][0]:
            self._states.popleft()
        if self._states and self._states[-1][0] == stamp:  # another robot has moved
            self._states.pop()
        own = next((one for one in state.others if one.name == self._robot), None)
        circles = [
            (*planar_pose(one.pose)[:2], one.radius) for one in state.others if one is not own
        ]
        if own is None:
            self._states.append((stamp, planar_pose(state.robot)))
            self._speeds = (state.forward, state.turn)
        else:
            self._states.append((stamp, planar_pose(own.pose)))
            self._speeds = (own.forward, own.turn)
            circles.append((*planar_pose(state.robot)[:2], state.radius))
        robots = np.array(circles, np.float64).reshape(-1, 3)
        self._people = np.concatenate((np.array(state.people.array).reshape(-1, 3), robots))

    @property
    def ray_targets(self) -> RayTargets:
        """Return everything that rays can hit now."""
        return RayTargets(self._segments, self._surfaces, self._people)

    def robot_at(self, began: int, times: Array) -> Array | None:
        """Return poses (n, 3) of the robot at increasing `times` (n,) [s] after `began` [ns].

        After the newest state the motion is extrapolated for a moment. None if the geometry or the
        robot's pose is not known yet.
        """
        if not self._geometry_known or not self._states:
            return None
        known: list[tuple[float, Pose]] = []
        for stamp, pose in reversed(self._states):
            known.append(((stamp - began) / SECOND, pose))
            if stamp <= began:
                break
        known.reverse()
        newest, pose = known[-1]
        ahead_s = min(float(times[-1]) - newest, _EXTRAPOLATED_S)
        if ahead_s > 0.0:
            known.append((newest + ahead_s, self._extrapolated(pose, ahead_s)))
        stamps = np.array([stamp for stamp, _ in known])
        poses = np.array([pose for _, pose in known])
        poses[:, 2] = np.unwrap(poses[:, 2])
        return np.column_stack([np.interp(times, stamps, column) for column in poses.T])

    def _extrapolated(self, pose: Pose, seconds: float) -> Pose:
        forward, turn = self._speeds
        half = (0.0, 0.0, 0.5 * turn * seconds)
        return compose(compose(compose(pose, half), (forward * seconds, 0.0, 0.0)), half)


def sensor_poses(poses: Array, mount: Pose) -> Array:
    """Return the poses (n, 3) of a sensor mounted at `mount` on a robot with these poses (n, 3)."""
    x, y, theta = mount
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    steps = np.column_stack(
        (cosine * x - sine * y, sine * x + cosine * y, np.full(len(poses), theta))
    )
    there: Array = poses + steps
    return there
