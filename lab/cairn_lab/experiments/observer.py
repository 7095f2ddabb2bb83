"""The components that record a run: the ground truth, and the estimates of one method."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import IO

import numpy as np
from pydantic import Field

from cairn import (
    LATCHED,
    RELIABLE,
    SECOND,
    CairnError,
    Component,
    Config,
    In,
    on,
    to_ns,
)
from cairn.planar.messages import planar_covariance, planar_pose, planar_poses
from cairn.planar.poses import wrap_all
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.cairn_msgs import (
    ObjectEvidenceArray,
    RecognizedObjectArray,
    VisualMap,
    VisualMapChange,
)
from cairn.schemas.cairn_nav_msgs import Collision, LocalizationEstimate, Relocalization
from cairn.schemas.geometry_msgs import PoseArray, PoseStamped

# Every message is recorded, also those of one instant of virtual time.
_LOSSLESS = RELIABLE.with_depth(500)

Value = float | int | str | bool | None | list["Value"]


class ObserverConfig(Config):
    """Parameters of an observer."""

    file: Path = Field(description="File of the series: lines of JSON.")


class Observer(Component):
    """Writes a series: lines of JSON, each [kind, stamp [s], values ...]."""

    # A series is one file.
    live_parameters = frozenset()
    config: ObserverConfig

    def on_configure(self) -> None:
        """Create the file."""
        file = self.config.file
        try:
            self._stream: IO[str] = file.open("w", encoding="utf-8")
        except OSError as error:
            raise CairnError(
                f"the series {file} cannot be written: {error.strerror}; name another folder"
            ) from error

    def on_cleanup(self) -> None:
        """Close the file."""
        self._close()

    def on_shutdown(self) -> None:
        """Close the file."""
        self._close()

    def _write(self, kind: str, stamp: Time, *values: Value) -> None:
        self._stream.write(json.dumps([kind, to_ns(stamp) / SECOND, *values]) + "\n")

    def _close(self) -> None:
        try:
            self._stream.close()
        except OSError as error:
            raise CairnError(
                f"the series {self.config.file} is incomplete: {error.strerror}; free some space "
                "there"
            ) from error


class WorldObserver(Observer):
    """Records the ground truth of a run, and the observations of the object recognizer.

    Lines of JSON, each [kind, stamp [s], values ...], in meters and radians:

    - pose: x, y, heading
    - objects: [[id, x, y], ...], true positions from then on
    - observation: id, range, bearing
    - collision: obstacle, x, y
    """

    truth: In[PoseStamped] = In(qos=_LOSSLESS)
    true_map: In[VisualMap] = In(qos=LATCHED.with_depth(100))
    recognized_objects: In[RecognizedObjectArray] = In(qos=_LOSSLESS)
    collisions: In[Collision] = In(qos=RELIABLE.with_depth(100), optional=True)

    @on("truth")
    def on_truth(self, truth: PoseStamped) -> None:
        """Record the robot's true pose."""
        self._write("pose", truth.header.stamp, *_rounded(*planar_pose(truth.pose)))

    @on("true_map")
    def on_true_map(self, true_map: VisualMap) -> None:
        """Record the true positions of the objects."""
        objects: list[Value] = [[o.object_id, *_rounded(o.x, o.y)] for o in true_map.objects]
        self._write("objects", true_map.header.stamp, objects)

    @on("recognized_objects")
    def on_recognized_objects(self, recognized: RecognizedObjectArray) -> None:
        """Record the observations of one image."""
        for one in recognized.objects:
            self._write(
                "observation",
                recognized.header.stamp,
                one.object_id,
                *_rounded(one.range, one.bearing),
            )

    @on("collisions")
    def on_collision(self, collision: Collision) -> None:
        """Record a collision."""
        position = _rounded(collision.x, collision.y)
        self._write("collision", collision.header.stamp, collision.obstacle, *position)


class MethodObserver(Observer):
    """Records the estimates of one localizer and the map of one map builder.

    Lines of JSON, each [kind, stamp [s], values ...], in meters and radians:

    - pose: x, y, heading, and the stated variances xx, xy, yy, heading
    - particles: variances of the particles: x, y, heading
    - landmark: id, x, y, state (0 live, 1 relocating), reliability, from then on
    - change: id, kind (as in cairn_msgs/VisualMapChange), old position, new position, reason
    - evidence: id, similarity, verdict (as in cairn_msgs/ObjectEvidence), distance, x, y, range,
      bearing, [robot's pose]
    - relocalized: x, y, heading, and the time [s] until which the robot was certainly not lost
      (0: unknown)
    """

    localization: In[LocalizationEstimate] = In(qos=_LOSSLESS)
    visual_map: In[VisualMap] = In(qos=LATCHED.with_depth(100))
    visual_map_changes: In[VisualMapChange] = In(qos=_LOSSLESS)
    object_evidence: In[ObjectEvidenceArray] = In(qos=_LOSSLESS)
    particles: In[PoseArray] = In(optional=True)
    relocalized: In[Relocalization] = In(optional=True)

    def on_configure(self) -> None:
        """Start with an empty map."""
        super().on_configure()
        self._landmarks: dict[int, list[Value]] = {}

    @on("localization")
    def on_localization(self, estimate: LocalizationEstimate) -> None:
        """Record the estimated pose and its covariance."""
        if not estimate.located:
            return
        pose, covariance = planar_pose(estimate.pose.pose), planar_covariance(estimate.pose)
        xx, xy, yy = covariance[0, 0], covariance[0, 1], covariance[1, 1]
        variances = [float(f"{value:.6g}") for value in (xx, xy, yy, covariance[2, 2])]
        self._write("pose", estimate.header.stamp, *_rounded(*pose), *variances)

    @on("particles")
    def on_particles(self, particles: PoseArray) -> None:
        """Record the variances of the particles: x, y [m^2] and heading [rad^2]."""
        x, y, theta = planar_poses(particles.poses).T
        mean = math.atan2(np.sin(theta).mean(), np.cos(theta).mean())
        variances = (x.var(), y.var(), np.mean(wrap_all(theta - mean) ** 2))
        rounded = (float(f"{value:.6g}") for value in variances)
        self._write("particles", particles.header.stamp, *rounded)

    @on("visual_map")
    def on_visual_map(self, visual_map: VisualMap) -> None:
        """Record the landmarks that have changed since the last map."""
        for o in visual_map.objects:
            row: list[Value] = [*_rounded(o.x, o.y), int(o.state), round(o.reliability, 6)]
            if self._landmarks.get(o.object_id) != row:
                self._landmarks[o.object_id] = row
                self._write("landmark", visual_map.header.stamp, o.object_id, *row)

    @on("visual_map_changes")
    def on_visual_map_change(self, change: VisualMapChange) -> None:
        """Record a change of the map."""
        old = _position(change.old_x, change.old_y)
        new = _position(change.new_x, change.new_y)
        stamp, kind = change.header.stamp, int(change.kind)
        self._write("change", stamp, change.object_id, kind, old, new, change.reason)

    @on("object_evidence")
    def on_object_evidence(self, frame: ObjectEvidenceArray) -> None:
        """Record the evidence of one image, and the robot pose that it was compared with."""
        robot: list[Value] = [*_rounded(frame.robot_x, frame.robot_y, frame.robot_theta)]
        for one in frame.evidence:
            self._write(
                "evidence",
                frame.header.stamp,
                one.object_id,
                round(one.similarity, 6),
                int(one.verdict),
                *_rounded(one.distance, one.x, one.y, one.range, one.bearing),
                robot,
            )

    @on("relocalized")
    def on_relocalized(self, relocalization: Relocalization) -> None:
        """Record a relocalization, and until when the robot was certainly not lost before."""
        pose = _rounded(*planar_pose(relocalization.pose.pose))
        confirmed_s = to_ns(relocalization.confirmed_until) / SECOND
        self._write("relocalized", relocalization.header.stamp, *pose, confirmed_s)


def _rounded(*values: float) -> list[float]:
    return [round(value, 5) for value in values]


def _position(x: float, y: float) -> Value:
    return None if math.isnan(x) else [round(x, 5), round(y, 5)]
