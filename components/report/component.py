"""The component that follows a run, knows the truth, and writes the report."""

import json
import math
import time
from pathlib import Path

from pydantic import Field

from cairn.bus.qos import LATCHED, RELIABLE
from cairn.clock import to_ns
from cairn.component.component import Component
from cairn.component.handlers import on
from cairn.component.parameters import Config
from cairn.component.ports import In
from components.report.record import RunRecord
from components.report.table import render_table
from schemas.cairn_msgs import ComponentStatus, VisualMap, VisualMapChange, VisualObject
from schemas.geometry_msgs import Pose, PoseStamped, PoseWithCovarianceStamped

_MANY = RELIABLE.with_depth(500)
_STATES = {
    VisualObject.LIVE: "live",
    VisualObject.RELOCATING: "relocating",
}


class ReportConfig(Config):
    """Where the report goes."""

    directory: str = Field(
        "", description="Folder for report.json, report.txt and the pictures; empty: none written."
    )


class Report(Component):
    """Compares a run with the truth and writes table, report.json and two pictures at its end."""

    config: ReportConfig

    pose: In[PoseWithCovarianceStamped] = In(qos=_MANY)
    truth: In[PoseStamped] = In(qos=_MANY, optional=True)
    true_map: In[VisualMap] = In(qos=LATCHED, optional=True)
    visual_map: In[VisualMap] = In(qos=LATCHED.with_depth(100))
    visual_map_changes: In[VisualMapChange] = In(qos=_MANY)
    component_status: In[ComponentStatus] = In(qos=LATCHED.with_depth(500), optional=True)

    def on_configure(self) -> None:
        """Begin an empty record; see that the folder can be written before the run, not after."""
        self._record = RunRecord()
        self._started: float | None = None
        self._virtual = False
        if self.config.directory:
            Path(self.config.directory).mkdir(parents=True, exist_ok=True)

    @on("pose")
    def follow(self, pose: PoseWithCovarianceStamped) -> None:
        """Keep the estimated pose."""
        stamp = to_ns(pose.header.stamp)
        self._lives_at(stamp)
        self._record.estimate_stamps.append(stamp)
        self._record.estimate.append(_pose(pose.pose.pose))

    @on("truth")
    def follow_truth(self, truth: PoseStamped) -> None:
        """Keep the true pose."""
        stamp = to_ns(truth.header.stamp)
        self._lives_at(stamp)
        self._record.truth_stamps.append(stamp)
        self._record.truth.append(_pose(truth.pose))

    @on("true_map")
    def know_truth(self, true_map: VisualMap) -> None:
        """Keep the objects' true places."""
        for thing in true_map.objects:
            self._record.object(thing.object_id).true_place = (thing.x, thing.y)

    @on("visual_map")
    def follow_map(self, visual_map: VisualMap) -> None:
        """Keep each object's place, state and reliability; the first map is the one given."""
        stamp = to_ns(visual_map.header.stamp)
        first = not any(record.history for record in self._record.objects.values())
        for thing in visual_map.objects:
            record = self._record.object(thing.object_id)
            place = (thing.x, thing.y)
            known = all(math.isfinite(value) for value in place)
            if first and known:
                record.map_place = place
            record.name = thing.name
            record.place = place if known else None
            record.state = _STATES[thing.state]
            record.reliability = thing.reliability
            record.history.append((stamp, thing.reliability))

    @on("visual_map_changes")
    def follow_changes(self, change: VisualMapChange) -> None:
        """Note when an object was removed or registered."""
        record = self._record.object(change.object_id)
        stamp = to_ns(change.header.stamp)
        if change.kind == VisualMapChange.REMOVED:
            record.removed_at, record.registered_at = stamp, None
        elif change.kind == VisualMapChange.REGISTERED:
            record.registered_at = stamp
        elif change.kind == VisualMapChange.RESTORED:
            record.removed_at = record.registered_at = None

    @on("component_status")
    def count_losses(self, status: ComponentStatus) -> None:
        """Keep every port's counters of messages dropped and refused."""
        # In lockstep nobody's time is the wall's: without it the same run gives the same report.
        self._virtual = status.placement == "lockstep"
        for port in status.ports:
            if port.direction == port.IN:
                name = f"{status.component}.{port.port}"
                self._record.dropped[name] = port.dropped
                self._record.invalid[name] = port.invalid

    def on_deactivate(self) -> None:
        """Write the report."""
        wall_s = None if self._started is None else time.monotonic() - self._started
        if not self.config.directory:
            return
        # Matplotlib takes half a second and 40 MB: not before the run is over.
        from components.report.pictures import draw_map, draw_reliability

        folder = Path(self.config.directory)
        summary = self._record.summary(None if self._virtual else wall_s)
        text = json.dumps(summary, indent=1, sort_keys=False, allow_nan=False)
        draw_map(self._record, folder / "map.png")
        draw_reliability(self._record, folder / "reliability.png")
        (folder / "report.txt").write_text(render_table(summary), encoding="utf-8")
        (folder / "report.json").write_text(text + "\n", encoding="utf-8")
        self.log.info("report written to %s", folder)

    def _lives_at(self, stamp: int) -> None:
        if self._started is None:
            # How long the computer takes is the one thing that `clock` does not tell.
            self._started = time.monotonic()
        self._record.at(stamp)


def _pose(pose: Pose) -> tuple[float, float, float]:
    q = pose.orientation
    yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
    return pose.position.x, pose.position.y, yaw
