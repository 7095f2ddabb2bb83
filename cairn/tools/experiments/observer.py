"""The components that write down a run: what was true, and what one pair made of it."""

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
    ParameterRejected,
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

_MANY = RELIABLE.with_depth(500)

Value = float | int | str | bool | None | list["Value"]


class ObserverConfig(Config):
    """Where the series goes."""

    file: Path = Field(description="Where to write the series: lines of JSON.")


class Observer(Component):
    """Writes lines of JSON, [kind, stamp [s], ...]: see `docs/how-to/experiments.md`."""

    config: ObserverConfig

    def on_configure(self) -> None:
        """Begin the file."""
        file = self.config.file
        try:
            self._stream: IO[str] = file.open("w", encoding="utf-8")
        except OSError as error:
            raise CairnError(
                f"the series {file} cannot be written: {error.strerror}; name another folder"
            ) from error

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """A series goes to one file."""
        raise ParameterRejected("an observer takes its parameters when it is configured")

    def on_cleanup(self) -> None:
        """Close the file."""
        self._close()

    def on_shutdown(self) -> None:
        """Close the file."""
        self._close()

    def _write(self, what: str, stamp: Time, *values: Value) -> None:
        self._stream.write(json.dumps([what, to_ns(stamp) / SECOND, *values]) + "\n")

    def _close(self) -> None:
        try:
            self._stream.close()
        except OSError as error:
            raise CairnError(
                f"the series {self.config.file} is not complete: {error.strerror}; make room there"
            ) from error


class WorldObserver(Observer):
    """Writes down what was true in a run, and what the recognizer told of it."""

    truth: In[PoseStamped] = In(qos=_MANY)
    true_map: In[VisualMap] = In(qos=LATCHED.with_depth(100))
    recognized_objects: In[RecognizedObjectArray] = In(qos=_MANY)
    collisions: In[Collision] = In(qos=RELIABLE.with_depth(100), optional=True)

    @on("truth")
    def follow(self, truth: PoseStamped) -> None:
        """Write where the robot is."""
        self._write("pose", truth.header.stamp, *_rounded(*planar_pose(truth.pose)))

    @on("true_map")
    def survey(self, true_map: VisualMap) -> None:
        """Write where the objects stand."""
        places: list[Value] = [[o.object_id, *_rounded(o.x, o.y)] for o in true_map.objects]
        self._write("places", true_map.header.stamp, places)

    @on("recognized_objects")
    def see(self, seen: RecognizedObjectArray) -> None:
        """Write what was recognized."""
        for one in seen.objects:
            self._write(
                "sighting",
                seen.header.stamp,
                one.object_id,
                *_rounded(one.range, one.bearing),
            )

    @on("collisions")
    def touch(self, touch: Collision) -> None:
        """Write what the robot touched."""
        self._write("collision", touch.header.stamp, touch.obstacle, *_rounded(touch.x, touch.y))


class PairObserver(Observer):
    """Writes down what one localizer and one map builder made of a run."""

    localization: In[LocalizationEstimate] = In(qos=_MANY)
    visual_map: In[VisualMap] = In(qos=LATCHED.with_depth(100))
    visual_map_changes: In[VisualMapChange] = In(qos=_MANY)
    object_evidence: In[ObjectEvidenceArray] = In(qos=_MANY)
    particles: In[PoseArray] = In(optional=True)
    relocalized: In[Relocalization] = In(optional=True)

    def on_configure(self) -> None:
        """Nothing was mapped yet."""
        super().on_configure()
        self._mapped: dict[int, list[Value]] = {}

    @on("localization")
    def on_localization(self, told: LocalizationEstimate) -> None:
        """Write the estimated pose and its covariance."""
        if not told.located:
            return
        pose, covariance = planar_pose(told.pose.pose), planar_covariance(told.pose)
        xx, xy, yy = covariance[0, 0], covariance[0, 1], covariance[1, 1]
        variances = [float(f"{value:.6g}") for value in (xx, xy, yy, covariance[2, 2])]
        self._write("pose", told.header.stamp, *_rounded(*pose), *variances)

    @on("particles")
    def look(self, cloud: PoseArray) -> None:
        """Write how far the samples are spread: variances of x, y [m^2] and heading [rad^2]."""
        x, y, theta = planar_poses(cloud.poses).T
        middle = math.atan2(np.sin(theta).mean(), np.cos(theta).mean())
        variances = (x.var(), y.var(), np.mean(wrap_all(theta - middle) ** 2))
        self._write("cloud", cloud.header.stamp, *(float(f"{value:.6g}") for value in variances))

    @on("visual_map")
    def read(self, visual_map: VisualMap) -> None:
        """Write those objects of the map that are not as they were."""
        for o in visual_map.objects:
            row: list[Value] = [*_rounded(o.x, o.y), int(o.state), round(o.reliability, 6)]
            if self._mapped.get(o.object_id) != row:
                self._mapped[o.object_id] = row
                self._write("object", visual_map.header.stamp, o.object_id, *row)

    @on("visual_map_changes")
    def note(self, change: VisualMapChange) -> None:
        """Write a change of the map."""
        old = _place(change.old_x, change.old_y)
        new = _place(change.new_x, change.new_y)
        stamp, kind = change.header.stamp, int(change.kind)
        self._write("change", stamp, change.object_id, kind, old, new, change.reason)

    @on("object_evidence")
    def weigh(self, frame: ObjectEvidenceArray) -> None:
        """Write what one image says of each object, and the pose that it was compared with."""
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
    def find(self, found: Relocalization) -> None:
        """Write that the robot was lost and found itself, and until when it was sure not to be."""
        pose = _rounded(*planar_pose(found.pose.pose))
        self._write("relocalized", found.header.stamp, *pose, to_ns(found.confirmed_until) / SECOND)


def _rounded(*values: float) -> list[float]:
    return [round(value, 5) for value in values]


def _place(x: float, y: float) -> Value:
    return None if math.isnan(x) else [round(x, 5), round(y, 5)]
