"""The component Report: compares a run with the truth, and writes the report."""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import Field

from cairn import (
    LATCHED,
    RELIABLE,
    CairnError,
    Component,
    Config,
    In,
    RetriedSave,
    every,
    on,
    to_ns,
)
from cairn.components.run_outputs.run_journal import RunJournal, Value
from cairn.components.run_outputs.run_record import RunRecord
from cairn.components.run_outputs.table import render_table
from cairn.components.run_outputs.trajectory import TrajectoryFile
from cairn.planar.messages import planar_pose, planar_poses
from cairn.schemas.cairn_msgs import ComponentStatus, VisualMap, VisualMapChange, VisualObject
from cairn.schemas.cairn_nav_msgs import (
    NAVIGATION_STATES,
    Collision,
    LocalizationEstimate,
    NavigateGoal,
    NavigationStatus,
)
from cairn.schemas.geometry_msgs import Pose, PoseStamped
from cairn.schemas.nav_msgs import OccupancyGrid
from cairn.system.files import TAKES_NO_DATA

_MANY = RELIABLE.with_depth(500)
_STATES = {
    VisualObject.LIVE: "live",
    VisualObject.RELOCATING: "relocating",
}


class ReportConfig(Config):
    """Parameters of the report."""

    directory: str = Field(
        "",
        description="Folder for report.json, report.txt, trajectory.tum, truth.tum and the "
        "pictures; empty: none written.",
    )


class Report(Component):
    """Compares a run with the truth and writes report.txt, report.json and two pictures at its
    end; during the run, every estimated pose to trajectory.tum, and every true one to truth.tum.
    """

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
        """Start a record; check that the folder can be written before the run, not after it."""
        self._record = RunRecord()
        self._virtual = False
        self._grids: tuple[OccupancyGrid, OccupancyGrid] | None = None
        self._objects: dict[int, tuple[int, str, float, float, str, float]] = {}
        self._moved: tuple[int, str, int] | None = None
        self._journal: RunJournal | None = None
        self._trajectories: dict[str, TrajectoryFile] = {}
        if self.config.directory:
            journal = Path(self.config.directory) / "record.jsonl"
            _check_can_be_written(journal)
            saved = RetriedSave(self, "report journal")
            self._journal = RunJournal(self._record, journal, saved, resume=self.restarts > 0)
            for name in ("trajectory", "truth"):
                file = journal.with_name(f"{name}.tum")
                with _disk_errors_explained(file.parent):
                    saved = RetriedSave(self, f"report's {name}")
                    self._trajectories[name] = TrajectoryFile(file, saved, resume=self.restarts > 0)

    @every(hz=10)
    def on_start(self) -> None:
        """Record the start of the run: as soon as the clock has a time, whatever else arrives."""
        if self._record.began_s is None and self.clock.now():
            # The robot's clock does not measure how long the computer takes.
            self._write("record_start", time.monotonic(), self.clock.now())

    @on("localization")
    def on_localization(self, estimate: LocalizationEstimate) -> None:
        """Record the estimated pose."""
        if estimate.located:
            stamp = to_ns(estimate.header.stamp)
            self._write("record_estimate", stamp, *planar_pose(estimate.pose.pose))
            self._add_pose("trajectory", stamp, estimate.pose.pose)

    @on("truth")
    def on_truth(self, truth: PoseStamped) -> None:
        """Record the true pose."""
        stamp = to_ns(truth.header.stamp)
        self._write("record_truth", stamp, *planar_pose(truth.pose))
        self._add_pose("truth", stamp, truth.pose)

    @on("true_map")
    def on_true_map(self, true_map: VisualMap) -> None:
        """Record the objects' true positions."""
        for landmark in true_map.objects:
            self._write("record_true_position", landmark.object_id, landmark.x, landmark.y)

    @on("visual_map")
    def on_visual_map(self, visual_map: VisualMap) -> None:
        """Record position, state and reliability of the objects that have changed."""
        objects = {
            landmark.object_id: (
                landmark.object_id,
                landmark.name,
                landmark.x,
                landmark.y,
                _STATES[landmark.state],
                landmark.reliability,
            )
            for landmark in visual_map.objects
        }
        changed: list[Value] = [
            one for key, one in objects.items() if one != self._objects.get(key)
        ]
        if changed or not self._objects:
            self._write("record_map", to_ns(visual_map.header.stamp), changed)
        self._objects = objects

    @on("visual_map_changes")
    def on_visual_map_change(self, change: VisualMapChange) -> None:
        """Record removals, registrations, and restorations of objects."""
        stamp, landmark = to_ns(change.header.stamp), change.object_id
        if change.kind == VisualMapChange.REMOVED:
            self._write("record_removal", stamp, landmark, change.old_x, change.old_y)
        elif change.kind == VisualMapChange.REGISTERED:
            self._write("record_registration", stamp, landmark)
        elif change.kind == VisualMapChange.RESTORED:
            self._write("record_restoration", landmark, change.new_x, change.new_y)

    @on("map")
    def on_map(self, message: OccupancyGrid) -> None:
        """Keep the first and the newest grid map."""
        self._grids = (self._grids[0] if self._grids else message, message)

    @on("navigate_goal")
    def on_navigate_goal(self, mission: NavigateGoal) -> None:
        """Record the goals of a mission."""
        if len(mission.goals):
            goals: list[Value] = [list(row) for row in planar_poses(mission.goals).tolist()]
            self._write("record_mission", mission.mission_id, goals)

    @on("navigation_status")
    def on_navigation_status(self, status: NavigationStatus) -> None:
        """Record the progress of a mission when it changes."""
        state = NAVIGATION_STATES[status.state]
        now = (status.mission_id, state, status.goal)
        if now == self._moved:
            return
        self._moved = now
        self._write(
            "record_progress",
            status.mission_id,
            state,
            status.goal,
            status.reason,
            status.elapsed,
            status.recoveries,
        )

    @on("collisions")
    def on_collision(self, collision: Collision) -> None:
        """Record a collision."""
        self._write(
            "record_collision",
            to_ns(collision.header.stamp),
            collision.obstacle,
            collision.x,
            collision.y,
            collision.speed,
        )

    @on("component_status")
    def on_component_status(self, status: ComponentStatus) -> None:
        """Record each port's counters of dropped and rejected messages."""
        # In lockstep the wall clock has no meaning: without it the same run gives the same report.
        self._virtual = status.placement == "lockstep"
        for port in status.ports:
            counts = (port.dropped, port.invalid)
            name = f"{status.component}.{port.port}"
            if (
                port.direction == port.IN
                and self._record.port_counters(name, status.restarts) != counts
            ):
                self._write("record_port_counters", name, status.restarts, *counts)

    def on_deactivate(self) -> None:
        """Write the report."""
        if self._journal is None:
            return
        # Matplotlib takes half a second and 40 MB: it is imported after the run.
        from cairn.components.run_outputs.pictures import draw_map, draw_reliability

        for trajectory in self._trajectories.values():
            trajectory.close()
        if self.clock.now():  # a report that was restarted at the very end
            self._write("record_end", self.clock.now())
        folder = Path(self.config.directory)
        summary = self._record.summary(None if self._virtual else time.monotonic())
        text = json.dumps(summary, indent=1, sort_keys=False, allow_nan=False)
        with _disk_errors_explained(folder):
            draw_map(self._record, self._grids, folder / "map.png")
            draw_reliability(self._record, folder / "reliability.png")
            (folder / "report.txt").write_text(render_table(summary), encoding="utf-8")
            (folder / "report.json").write_text(text + "\n", encoding="utf-8")
            self._journal.remove()
        self.log.info("report written to %s", folder)

    def _add_pose(self, name: str, stamp: int, pose: Pose) -> None:
        if name in self._trajectories and not self._trajectories[name].add(stamp, pose):
            self._write("record_omission", f"poses in {name}.tum")

    def _write(self, method: str, *values: Value) -> None:
        if self._journal is not None:
            self._journal.write(method, *values)


def _check_can_be_written(file: Path) -> None:
    """Raise `CairnError` unless a file can be written, now or when the disk takes data again."""
    with _disk_errors_explained(file.parent):
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.open("ab").close()
        except OSError as error:
            if error.errno not in TAKES_NO_DATA:
                raise


@contextmanager
def _disk_errors_explained(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise CairnError(
            f"report: cannot write {error.filename or folder}: {error.strerror}; choose "
            "another folder (`--report`), or free disk space"
        ) from error
