"""The component Explorer: sends the robot to frontiers until nothing reachable is unknown."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from cairn import (
    LATCHED,
    RELIABLE,
    SECOND,
    CairnError,
    Component,
    In,
    Out,
    RetriedSave,
    SteadyClock,
    every,
    from_ns,
    on,
)
from cairn.components.explorer.choice import SAME_M, FrontierChoice
from cairn.components.explorer.config import ExplorerConfig
from cairn.components.explorer.frontiers import (
    Clearance,
    Frontier,
    FrontierSearch,
    Reach,
    free_area,
)
from cairn.limits.files import read_bounded
from cairn.planar.grid import Grid, OccupancyCells, grid_of
from cairn.planar.messages import packed_poses, planar_pose, planar_poses
from cairn.planar.poses import Pose, apart
from cairn.planar.zone_cells import keepout_cells
from cairn.schemas.cairn_nav_msgs import (
    EXPLORATION_STATES,
    NAVIGATION_END_STATES,
    ExplorationStatus,
    LocalizationEstimate,
    NavigateGoal,
    NavigationStatus,
    Zone,
    Zones,
)
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.schemas.nav_msgs import OccupancyGrid
from cairn.schemas.std_msgs import Header
from cairn.system.files import replace_file

# The map is published every second. After so long [s] without a frontier the exploration is
# finished; so long after the robot's arrival the map shows what it has seen from there.
_SETTLED_S = 3.0
# A goal that the supervisor has not accepted, or of which AutoMove has published nothing, for so
# long [s] is sent again: one of them was restarted. So many times in a row.
_SILENT_S, _MOST_RESENT = 20.0, 3
# A mission that is closed without a result of AutoMove for so long [s] was canceled.
_CANCELED_S = 5.0
# An input may be missing for so long [s]: longer than a component takes to be restarted.
_MISSING_S = 60.0
# A robot that is not located for so long [s] gets a goal: AutoMove then looks around and drives on
# until it is. After so long [s] without success, the exploration ends.
_LOST_S, _LOOKED_AROUND_S = 5.0, 300.0
# Goals that are known as the explorer's own [1]: those that were sent last.
_OWN = 20
# Between two of two decisions in a second no more time passes [s]; more is a step of the clock.
_LONGEST_STEP_S = 2.0
_SAME_GOAL = 1e-6  # [m], [rad]
_STATE_BYTES = 1000


@dataclass
class _Goal:
    """The goal under way: where it leads to, and what is known of its mission.

    Without a frontier, it is there to find the robot in the map.
    """

    pose: Pose
    frontier: Frontier | None
    heard_ns: int
    mission_id: int | None = None
    closed_ns: int | None = None
    arrived_ns: int | None = None


class Explorer(Component):
    """Explores: drives to the borders of what is mapped until nothing reachable is unknown.

    The requests `explore` and `stop` start and end it. A mission of anyone else ends it, too.
    """

    live_parameters = frozenset({"radius", "margin"})
    config: ExplorerConfig

    request_roles = MappingProxyType({"explore": "operate", "stop": "operate", "status": "view"})
    urgent_requests = frozenset({"stop"})

    map: In[OccupancyGrid] = In(qos=LATCHED)
    map_updates: In[OccupancyGridUpdate] = In(qos=RELIABLE.with_depth(50))
    zones: In[Zones] = In(qos=LATCHED, optional=True)
    localization: In[LocalizationEstimate]
    navigate_goal: In[NavigateGoal] = In(qos=LATCHED)
    navigation_status: In[NavigationStatus] = In(qos=LATCHED.with_depth(20))
    exploration_goal: Out[NavigateGoal] = Out(qos=RELIABLE)
    exploration_status: Out[ExplorationStatus] = Out(qos=LATCHED)

    _goal: _Goal | None = None
    _reach: Reach | None = None
    _complete_ns = _frontier_ns = 0  # the last times of complete inputs, and of a frontier

    def on_configure(self) -> None:
        """Start without a map, and idle."""
        file = self.config.state_file
        if file is not None and not file.parent.is_dir():
            raise CairnError(f"{file.parent}: no such folder for the state_file")
        if file is not None and self.restarts == 0:
            file.unlink(missing_ok=True)
        self._steady = SteadyClock(self.clock, _LONGEST_STEP_S)
        self._saved = RetriedSave(self, "exploration")
        self._search = FrontierSearch()
        self._grid: OccupancyCells | None = None
        self._zones: tuple[Zone, ...] = ()
        self._map_changed = False
        self._state = int(ExplorationStatus.IDLE)
        self._reason = ""
        self._begin_ns = self._end_ns = 0
        self._reset()

    def on_activate(self) -> None:
        """Start exploring if that is configured, or if an earlier process was exploring."""
        earlier, goal = self._load()
        if earlier:
            self.log.warning("continued the exploration")
        if earlier or (self.restarts == 0 and self.config.explore == "on_activation"):
            self._start()
        if goal is not None:
            self._own.append(goal)
        self._publish()

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Answer `explore`, `stop` and `status` with the status."""
        if verb not in ("explore", "stop", "status") or arguments:
            return super().on_request(verb, arguments)
        if verb == "explore" and not self._is_exploring:
            mission = self.navigate_goal.latest
            if mission is not None and len(mission.goals):
                raise CairnError(
                    f"{self.name}: mission {mission.mission_id} is under way; cancel it with "
                    "`cairn go --cancel`, or wait for its end"
                )
            self._start()
            self._publish()
        elif verb == "stop" and self._is_exploring:
            self._end(ExplorationStatus.STOPPED, "on request")
        status = self._status()
        return {
            "state": EXPLORATION_STATES[status.state],
            "frontiers": status.frontiers,
            "given_up": status.given_up,
            "known_area_m2": status.known_area,
            "elapsed_s": status.elapsed,
            "goal": None if math.isnan(status.goal_x) else [status.goal_x, status.goal_y],
            "reason": status.reason,
        }

    @on("map")
    def on_map(self, message: OccupancyGrid) -> None:
        """Take a map."""
        grid = grid_of(message)
        if grid.values.size:
            self._grid = Grid(np.array(grid.values), grid.frame)
            self._map_changed = True

    @on("map_updates")
    def on_map_update(self, update: OccupancyGridUpdate) -> None:
        """Take changes in a window of the map; the next full map corrects what does not fit."""
        if self._grid is None:
            return
        window = np.s_[update.y : update.y + update.height, update.x : update.x + update.width]
        cells = self._grid.values[window]
        if update.x >= 0 and update.y >= 0 and cells.shape == (update.height, update.width):
            cells[:] = update.data.reshape(cells.shape)
            self._map_changed = True

    @on("zones")
    def on_zones(self, message: Zones) -> None:
        """Take the zones of the map: frontiers in and behind keepout zones cannot be reached."""
        self._zones = message.zones
        self._map_changed = True

    @on("navigate_goal")
    def on_navigate_goal(self, mission: NavigateGoal) -> None:
        """Learn the number of the goal's mission; end if it is a mission of anyone else."""
        if not self._is_exploring:
            return
        goal = self._goal
        if mission.motion:
            self._end(ExplorationStatus.STOPPED, f"preempted by mission {mission.mission_id}")
            return
        if not len(mission.goals):
            if goal is not None and goal.mission_id == mission.mission_id:
                goal.closed_ns = goal.closed_ns or self._steady.now()
            return
        goals = planar_poses(mission.goals).tolist()
        if len(goals) > 1 or not any(_is_same(goals[0], own) for own in self._own):
            self._end(ExplorationStatus.STOPPED, f"preempted by mission {mission.mission_id}")
        elif goal is not None and _is_same(goals[0], goal.pose):
            goal.mission_id, goal.heard_ns = mission.mission_id, self._steady.now()
            self._resent = 0
            known = self.navigation_status.latest
            if known is not None:
                self.on_navigation_status(known)

    @on("navigation_status")
    def on_navigation_status(self, status: NavigationStatus) -> None:
        """Take the progress and the result of the goal's mission."""
        goal = self._goal
        if not self._is_exploring or goal is None or status.mission_id != goal.mission_id:
            return
        goal.heard_ns = self._steady.now()
        self._reason = status.reason
        if status.state not in NAVIGATION_END_STATES or goal.arrived_ns is not None:
            return
        if status.state == NavigationStatus.CANCELED:
            self._end(ExplorationStatus.STOPPED, "its goal was canceled")
        elif status.state == NavigationStatus.SUCCEEDED:
            goal.arrived_ns = self._steady.now()
        else:
            if goal.frontier is not None:
                self.log.warning("frontier not reached: %s", status.reason)
                self._choice.failed(goal.frontier)
            self._goal = None

    @every(hz=2)
    def explore(self) -> None:
        """Choose the next goal if the current one is not needed any more."""
        now = self._steady.now()
        if not self._is_exploring:
            return
        here, missing = self._missing()
        if missing or here is None or self._grid is None:
            self._reason = missing
            longest = _LOOKED_AROUND_S if self._is_lost else _MISSING_S
            if now - self._complete_ns > longest * SECOND:
                remedy = "; drive by hand until it is located" if self._is_lost else ""
                self._end(ExplorationStatus.FAILED, f"{missing} for {longest:.0f} s{remedy}")
                return
            if self._is_lost and self._goal is None and now - self._complete_ns > _LOST_S * SECOND:
                self.log.info("%s: looking around", missing)
                # Where the robot that has made the map began.
                self._send((0.0, 0.0, 0.0), None, now)
        else:
            self._explore(self._grid, here, now)
        if self._is_exploring:
            self._publish()

    def _explore(self, grid: OccupancyCells, here: Pose, now: int) -> None:
        if self._map_changed or self._goal is None:
            self._map_changed = False
            keepout = keepout_cells(self._zones, grid.frame, grid.values.shape)
            found = self._search.find(grid, here, self._needs(), keepout)
            self._area = free_area(grid)
            if found is None:
                self._reason = "the robot is enclosed by obstacles and keepout zones of the map"
                if now - self._complete_ns > _MISSING_S * SECOND:
                    self._end(ExplorationStatus.FAILED, self._reason)
                return
            self._reach = found
        self._complete_ns = now
        if self._goal is not None and not self._is_left(self._goal, now):
            return
        chosen = self._choice.best(self._frontiers)
        if chosen is not None:
            self._frontier_ns = now
            self.log.info(
                "exploring a frontier of %.1f m at (%.2f, %.2f); %d are reachable",
                chosen.width_m, *chosen.pose[:2], len(self._frontiers),
            )  # fmt: skip
            # After a try that did not show what is beyond, from nearer.
            pose = chosen.pose if self._choice.tries(chosen) else chosen.view
            self._send(pose, chosen, now)
        elif now - self._frontier_ns >= _SETTLED_S * SECOND:
            self._finish()

    def _is_left(self, goal: _Goal, now: int) -> bool:
        """Whether the robot needs another goal: what the goal is for is known, or it has ended."""
        if goal.arrived_ns is None and goal.closed_ns is not None:
            if now - goal.closed_ns > _CANCELED_S * SECOND:
                self._end(ExplorationStatus.STOPPED, "its goal was canceled")
            return False
        reach = self._reach
        if goal.frontier is None or reach is None:
            return True
        x, y, _ = goal.frontier.pose
        if not reach.has_frontier_near(x, y, SAME_M):
            return True
        if goal.arrived_ns is not None:
            if now - goal.arrived_ns < _SETTLED_S * SECOND:
                return False
            self._choice.failed(goal.frontier)
            return True
        if now - goal.heard_ns <= _SILENT_S * SECOND:
            return not reach.has(goal.pose[0], goal.pose[1])  # a wall beside it was unknown
        self._resent += 1
        if self._resent > _MOST_RESENT:
            self._end(
                ExplorationStatus.FAILED,
                f"no answer to goals on {self.exploration_goal.topic}; see `cairn ps` for the "
                "supervisor and AutoMove",
            )
            return False
        return True

    def _send(self, pose: Pose, frontier: Frontier | None, now: int) -> None:
        self._goal = _Goal(pose, frontier, now)
        self._own.append(pose)
        self._save()
        goals = packed_poses(np.array([pose]))
        header = Header(stamp=from_ns(self.clock.now()), frame_id="map")
        self.exploration_goal.publish(NavigateGoal(header=header, goals=goals))

    def _finish(self) -> None:
        given_up = self._choice.given_up(self._frontiers)
        reason = "nothing that the robot can reach is unknown"
        if given_up:
            frontiers = "frontier" if given_up == 1 else "frontiers"
            reason += f", but for {given_up} {frontiers} that it could not explore"
        self._end(ExplorationStatus.FINISHED, reason)

    def _start(self) -> None:
        self._reset()
        self._state, self._reason = int(ExplorationStatus.EXPLORING), ""
        self._save()
        self.log.info("exploring")

    def _reset(self) -> None:
        self._choice = FrontierChoice()
        self._reach = None
        self._area = 0.0
        self._goal = None
        self._own: deque[Pose] = deque(maxlen=_OWN)
        self._resent = 0
        self._begin_ns = self._complete_ns = self._frontier_ns = self._steady.now()

    def _end(self, state: int, reason: str) -> None:
        self._state, self._reason = int(state), reason
        self._end_ns = self._steady.now()
        self.log.info("exploration %s: %s", EXPLORATION_STATES[self._state], reason)
        if self._goal is not None:
            header = Header(stamp=from_ns(self.clock.now()), frame_id="map")
            self.exploration_goal.publish(NavigateGoal(header=header))
            self._goal = None
        self._save()
        self._publish()
        if self.config.finish:
            self.finish(f"exploration {EXPLORATION_STATES[self._state]}: {reason}",
                        success=state == ExplorationStatus.FINISHED)  # fmt: skip

    @property
    def _frontiers(self) -> tuple[Frontier, ...]:
        return () if self._reach is None else self._reach.frontiers

    @property
    def _is_exploring(self) -> bool:
        return self._state == ExplorationStatus.EXPLORING

    def _missing(self) -> tuple[Pose | None, str]:
        """Return the robot's pose, or which input is missing."""
        estimate = self.localization.latest
        if self._grid is None:
            return None, f"no map yet on {self.map.topic}"
        if estimate is None:
            return None, f"no estimate yet on {self.localization.topic}"
        if not estimate.located:
            return None, f"the robot is not located: {estimate.reason}"
        return planar_pose(estimate.pose.pose), ""

    @property
    def _is_lost(self) -> bool:
        """Whether there is a map in which the robot has not been found, or not again."""
        estimate = self.localization.latest
        return self._grid is not None and estimate is not None and not estimate.located

    def _needs(self) -> Clearance:
        config, grid = self.config, self._grid
        assert grid is not None
        return Clearance(
            fits_m=config.radius + config.margin + 0.5 * grid.frame.resolution,
            body_m=config.radius + config.margin,
            width_m=2.0 * config.radius,
        )

    def _status(self) -> ExplorationStatus:
        end_ns = self._steady.now() if self._is_exploring else self._end_ns
        x, y, _ = (math.nan,) * 3 if self._goal is None else self._goal.pose
        return ExplorationStatus(
            header=Header(stamp=from_ns(self.clock.now()), frame_id="map"),
            state=self._state,
            frontiers=len(self._frontiers),
            given_up=self._choice.given_up(self._frontiers),
            known_area=self._area,
            elapsed=max(0.0, (end_ns - self._begin_ns) / SECOND),
            goal_x=x,
            goal_y=y,
            reason=self._reason,
        )

    def _publish(self) -> None:
        status = self._status()
        self.exploration_status.publish(status)
        frontiers = "1 frontier" if status.frontiers == 1 else f"{status.frontiers} frontiers"
        self.report_state(f"exploring: {frontiers}" if self._is_exploring else "")

    def _save(self) -> None:
        """Mark an exploration under way, with its goal, in the file; remove the mark at the end."""
        file = self.config.state_file
        if file is None:
            return
        if not self._is_exploring:
            file.unlink(missing_ok=True)
            return
        state = {"goal": None if self._goal is None else list(self._goal.pose)}
        self._saved.attempt(
            lambda: replace_file(file, json.dumps(state).encode(), durable=False),
            lambda: "the exploration does not continue",
            now=True,
        )

    def _load(self) -> tuple[bool, Pose | None]:
        """Return whether an earlier process was exploring, and its goal."""
        file = self.config.state_file
        if file is None or self.restarts == 0 or not file.exists():
            return False, None
        try:
            goal = json.loads(read_bounded(file, _STATE_BYTES))["goal"]
            if goal is None:
                return True, None
            x, y, theta = (float(value) for value in goal)
        except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
            self.log.error("exploration not continued: %s cannot be read: %s", file, error)
            return False, None
        return True, (x, y, theta)


def _is_same(goal: Pose, other: Pose) -> bool:
    return not apart(goal, other, _SAME_GOAL, _SAME_GOAL)
