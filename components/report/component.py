"""The component that follows a run, knows the truth, and writes the report."""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import Field

from cairn import LATCHED, RELIABLE, CairnError, Component, Config, In, every, on, to_ns
from cairn.components.report.journal import Journal, Value
from cairn.components.report.record import RunRecord
from cairn.components.report.table import render_table
from cairn.planar.messages import planar_pose, planar_poses
from cairn.schemas.cairn_msgs import ComponentStatus, VisualMap, VisualMapChange, VisualObject
from cairn.schemas.cairn_nav_msgs import (
    NAVIGATION_STATES,
    Collision,
    LocalizationEstimate,
    NavigateGoal,
    NavigationStatus,
)
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.schemas.nav_msgs import OccupancyGrid

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

    localization: In[LocalizationEstimate] = In(qos=_MANY)
    truth: In[PoseStamped] = In(qos=_MANY, optional=True)
    true_map: In[VisualMap] = In(qos=LATCHED, optional=True)
    visual_map: In[VisualMap] = In(qos=LATCHED.with_depth(100), optional=True)
    visual_map_changes: In[VisualMapChange] = In(qos=_MANY, optional=True)
    map: In[OccupancyGrid] = In(qos=LATCHED.with_depth(10), optional=True)
    navigate_goal: In[NavigateGoal] = In(qos=LATCHED.with_depth(20), optional=True)
    navigation_status: In[NavigationStatus] = In(qos=LATCHED.with_depth(100), optional=True)
    collisions: In[Collision] = In(qos=RELIABLE.with_depth(100), optional=True)
    component_status: In[ComponentStatus] = In(qos=LATCHED.with_depth(500), optional=True)

    def on_configure(self) -> None:
        """Begin a record; see that the folder can be written before the run, not after."""
        self._record = RunRecord()
        self._virtual = False
        self._grids: tuple[OccupancyGrid, OccupancyGrid] | None = None
        self._moved: tuple[int, str, int] | None = None
        self._journal: Journal | None = None
        if self.config.directory:
            folder = Path(self.config.directory)
            with _told(folder):
                folder.mkdir(parents=True, exist_ok=True)
                resume = self.restarts > 0
                self._journal = Journal(
                    self._record, folder / "record.jsonl", self.log, resume=resume
                )

    @every(hz=10)
    def begin(self) -> None:
        """Note when the run began: as soon as its clock tells a time, whatever else comes."""
        if self._record.began_s is None and self.clock.now():
            # How long the computer takes is the one thing that `clock` does not tell.
            self._note("begins", time.monotonic(), self.clock.now())

    @on("localization")
    def on_localization(self, estimate: LocalizationEstimate) -> None:
        """Record the estimated pose."""
        if estimate.located:
            stamp = to_ns(estimate.header.stamp)
            self._note("estimated", stamp, *planar_pose(estimate.pose.pose))

    @on("truth")
    def follow_truth(self, truth: PoseStamped) -> None:
        """Keep the true pose."""
        self._note("was_truly_at", to_ns(truth.header.stamp), *planar_pose(truth.pose))

    @on("true_map")
    def know_truth(self, true_map: VisualMap) -> None:
        """Keep the objects' true places."""
        for thing in true_map.objects:
            self._note("stands_truly_at", thing.object_id, thing.x, thing.y)

    @on("visual_map")
    def follow_map(self, visual_map: VisualMap) -> None:
        """Keep each object's place, state and reliability; the first map is the one given."""
        objects: list[Value] = [
            [thing.object_id, thing.name, thing.x, thing.y, _STATES[thing.state], thing.reliability]
            for thing in visual_map.objects
        ]
        self._note("mapped", to_ns(visual_map.header.stamp), objects)

    @on("visual_map_changes")
    def follow_changes(self, change: VisualMapChange) -> None:
        """Note when an object was removed or registered, and what of it was taken back."""
        stamp, thing = to_ns(change.header.stamp), change.object_id
        if change.kind == VisualMapChange.REMOVED:
            self._note("was_removed", stamp, thing, change.old_x, change.old_y)
        elif change.kind == VisualMapChange.REGISTERED:
            self._note("was_registered", stamp, thing)
        elif change.kind == VisualMapChange.RESTORED:
            self._note("was_restored", thing, change.new_x, change.new_y)

    @on("map")
    def follow_grid(self, message: OccupancyGrid) -> None:
        """Keep the grid map as it was first, and as it is now."""
        self._grids = (self._grids[0] if self._grids else message, message)

    @on("navigate_goal")
    def follow_orders(self, order: NavigateGoal) -> None:
        """Keep the goals of an order."""
        if len(order.goals):
            goals: list[Value] = [list(row) for row in planar_poses(order.goals).tolist()]
            self._note("ordered", order.mission_id, goals)

    @on("navigation_status")
    def follow_moves(self, status: NavigationStatus) -> None:
        """Keep how an order gets on, when that changes."""
        state = NAVIGATION_STATES[status.state]
        now = (status.mission_id, state, status.goal)
        if now == self._moved:
            return
        self._moved = now
        self._note(
            "moved_on",
            status.mission_id,
            state,
            status.goal,
            status.reason,
            status.elapsed,
            status.recoveries,
        )

    @on("collisions")
    def note_collision(self, touch: Collision) -> None:
        """Keep a collision."""
        self._note(
            "collided", to_ns(touch.header.stamp), touch.obstacle, touch.x, touch.y, touch.speed
        )

    @on("component_status")
    def count_losses(self, status: ComponentStatus) -> None:
        """Keep every port's counters of messages dropped and refused."""
        # In lockstep nobody's time is the wall's: without it the same run gives the same report.
        self._virtual = status.placement == "lockstep"
        for port in status.ports:
            counts = (port.dropped, port.invalid)
            name = f"{status.component}.{port.port}"
            if port.direction == port.IN and self._record.losses(name, status.restarts) != counts:
                self._note("lost", name, status.restarts, *counts)

    def on_deactivate(self) -> None:
        """Write the report."""
        if self._journal is None:
            return
        # Matplotlib takes half a second and 40 MB: not before the run is over.
        from cairn.components.report.pictures import draw_map, draw_reliability

        if self.clock.now():  # a report begun anew at the very end may not have heard of it
            self._note("ends", self.clock.now())
        folder = Path(self.config.directory)
        summary = self._record.summary(None if self._virtual else time.monotonic())
        text = json.dumps(summary, indent=1, sort_keys=False, allow_nan=False)
        with _told(folder):
            draw_map(self._record, self._grids, folder / "map.png")
            draw_reliability(self._record, folder / "reliability.png")
            (folder / "report.txt").write_text(render_table(summary), encoding="utf-8")
            (folder / "report.json").write_text(text + "\n", encoding="utf-8")
            self._journal.remove()
        self.log.info("report written to %s", folder)

    def _note(self, what: str, *values: Value) -> None:
        if self._journal is not None:
            self._journal.tell(what, *values)


@contextmanager
def _told(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise CairnError(
            f"the report cannot be written to {error.filename or folder}: {error.strerror}; give "
            "another folder (`--report`), or make room there"
        ) from error
