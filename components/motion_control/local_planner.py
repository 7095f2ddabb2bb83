"""The local planner: follow the path where it is free, drive around obstacles on it, or stop.

Pure pursuit of a point ahead on the path (Coulter 1992), with a speed regulated by curvature, free
distance and clearance (Macenski et al. 2023). Each arc is checked against obstacles, as in the
dynamic window approach (Fox, Burgard, Thrun 1997).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.motion_control.collision_checks import (
    UNLIMITED_M,
    check_arcs,
    check_lines,
    first_free_again,
    free_length,
)
from cairn.components.motion_control.detour import SEARCH_RANGE_M, DetourSearch
from cairn.components.motion_control.followed_path import HORIZON_M, SPACING_M, FollowedPath
from cairn.components.motion_control.scan_memory import NearbyObstacles
from cairn.components.motion_control.velocity_limits import (
    MotionLimits,
    VelocityTarget,
)
from cairn.planar.poses import Pose, compose
from cairn.system.clock import SECOND, has_passed

Array = NDArray[np.float64]

OBSTACLE_RANGE_M = HORIZON_M + 0.3
"""Obstacles within this distance [m] of the robot are needed: the path and the robot's radius."""

# Where no other reason is given, these constants were chosen by hand; `lab/constants.yaml`
# has the effect of half and double.

# The pursued point is this far along the path [m]: nearer points make the robot oscillate, farther
# ones cut corners. Shares of the distance are tried where there is little room.
_MIN_AIM_M, _MAX_AIM_M = 0.35, 0.8
_AIM_SHARES = np.array([1.0, 0.75, 0.55, 0.4])
# The sharpest arc [1/m], of a radius of 0.125 m, and the farthest bearing [rad] of a point that an
# arc leads to: beyond, a turn on the spot is shorter.
_SHARPEST, _MOST_BEARING = 8.0, 1.3
# An arc with this clearance beyond what is needed [m] is good enough; otherwise one is better by
# this clearance [m].
_GOOD_CLEARANCE_M, _BETTER_CLEARANCE_M = 0.05, 0.01
# Turning on the spot starts when the path is this far off the heading, and ends here [rad]; the
# difference keeps the robot from alternating between both motions. In the hall with ten people
# (`cairn evaluate navigation --goals 3 --seeds 0..1`) half and double of the first value reach all
# goals without a collision on paths of 1.024 and 1.023 times the shortest; the present one 1.020.
_TURN_FROM, _TURN_TO = 1.0, 0.2
# An obstacle on the path nearer than this [m] is driven around. There, half and double reach all
# goals without a collision as well, on paths of 1.011 and 1.034 times the shortest.
_AVOID_WITHIN_M = 1.4
_CHECKED = round(_AVOID_WITHIN_M / SPACING_M) + 2
# Obstacles this near before the goal [m] do not stop the robot early: more than `stop_distance`.
_AT_GOAL_M = 0.3
_GOAL_SLACK_M = 0.06  # [m] that the goal itself may be out of reach
_REJOIN_POINTS = 16  # points of the path that must be free beyond an obstacle: 0.8 m
_RETRY_S = 0.3  # time without a new search after no detour was found
_MARGIN_SHARE = 0.6  # share of the margin that noise may take from a detour before it is dropped
_STOP_GAP_M = 0.02  # [m] of free path that is left where the robot stops
_STRAIGHT_SPEED = 0.25  # [m/s] without a path
_LEAST_SPEED = 0.05  # [m/s] that a base can follow
_STANDS = 0.01  # [m/s]: a slower target means that there is no room to move
_SLOW = 0.05  # [m/s]: a faster robot stops before it turns on the spot
_STRAIGHT_CHECK_M = 0.3  # [m] of the arc that is checked without a path
_ROOM_TO_TURN_M = 0.3  # [m] of free path after a turn on the spot, or the turn is not worth it
_DETOUR_GOES_ON_M = 0.5  # [m] by which the path continues beyond a detour, so no braking is needed
_ABOUT_HALF_A_TURN = 2.0  # [rad]: a larger turn may go either way


@dataclass(frozen=True)
class PlannerInput:
    """Robot pose in the odometry frame at `now` [ns], speed [m/s], and the obstacles around it."""

    now: int
    odom: Pose
    speed: float
    obstacles: NearbyObstacles


class LocalPlanner:
    """Follows the path ahead among obstacles; keeps to a started detour or turn."""

    def __init__(self, limits: MotionLimits) -> None:
        self._limits = limits
        self._room = limits.keepout_radius
        self._turning = False
        self._side = 0.0
        self._curvature = 0.0
        self._detour: FollowedPath | None = None
        self._searched_at = -round(_RETRY_S * SECOND)
        self._search = DetourSearch(limits)
        self._free = np.empty(_AIM_SHARES.size)
        self._clear = np.empty(_AIM_SHARES.size)

    def along(self, path_ahead: Array, left: float, inputs: PlannerInput) -> VelocityTarget:
        """Return the velocity along `path_ahead` (n, 2) [m], points `SPACING_M` apart, robot frame.

        `left` [m] is the path's length from here to its end.
        """
        target = self._follow_path_or_detour(path_ahead, left, inputs)
        if target.speed > 0.0 and not inputs.obstacles.ground_seen_ahead:
            return VelocityTarget(blocked=_UNSEEN)
        return target

    def _follow_path_or_detour(
        self, path_ahead: Array, left: float, inputs: PlannerInput
    ) -> VelocityTarget:
        self._room = self._limits.keepout_radius
        ahead = self._ahead(path_ahead, inputs)
        if self._detour is not None:
            target = self._follow_detour(ahead, inputs)
            if target is not None:
                return target
        if ahead >= min(_AVOID_WITHIN_M, left):
            target = self._follow(path_ahead, left, ahead, inputs)
            if target is not None:
                return target
        if has_passed(_RETRY_S, self._searched_at, inputs.now) and self._find_detour(
            path_ahead, ahead, inputs
        ):
            target = self._follow_detour(ahead, inputs)
            if target is not None:
                return target
        self._room = self._limits.minimum_radius
        ahead = self._ahead(path_ahead, inputs)
        target = None
        if ahead >= self._gap(ahead, left):
            target = self._follow(path_ahead, left, ahead, inputs)
        if target is None or (target.speed < _STANDS and target.turn == 0.0):
            return VelocityTarget(
                curvature=self._curvature, blocked=_blocked_reason(ahead, inputs, self._limits)
            )
        return target

    def _gap(self, ahead: float, left: float) -> float:
        """Return the gap [m] to an obstacle on the path: small where the goal is right at it."""
        return self._limits.stop_distance if left - ahead > _AT_GOAL_M else min(_STOP_GAP_M, left)

    def _ahead(self, path_ahead: Array, inputs: PlannerInput) -> float:
        """Return the free length [m] of the path, `UNLIMITED_M` if its first part is free."""
        return free_length(inputs.obstacles.points, path_ahead[:_CHECKED], SPACING_M, self._room)

    def straight(self, obstacles: NearbyObstacles, off: float, left: float) -> VelocityTarget:
        """Return the velocity straight on for `left` [m] in a direction `off` [rad] the heading."""
        self._turning = abs(off) > (0.5 * _TURN_TO if self._turning else _TURN_TO)
        if self._turning:
            return VelocityTarget(turn=self._limits.turn_rate_for(self._same_direction(off)))
        if not obstacles.ground_seen_ahead:
            return VelocityTarget(blocked=_UNSEEN)
        curvature = max(-1.0, min(1.0, 2.0 * off))
        self._check(obstacles.points, np.array([curvature]), np.array([_STRAIGHT_CHECK_M]))
        pace = self._pace(curvature, self._free[0], self._clear[0])
        pace = min(_STRAIGHT_SPEED, self._limits.speed_to_stop_in(left), pace)
        if pace <= _STANDS:
            gap = max(0.0, obstacles.nearest - self._limits.radius)
            return VelocityTarget(blocked=f"an obstacle {gap:.2f} m from the robot")
        return VelocityTarget(speed=max(_LEAST_SPEED, pace), curvature=curvature)

    def _follow(
        self, path_ahead: Array, left: float, ahead: float, inputs: PlannerInput
    ) -> VelocityTarget | None:
        """Pursue a path that is free for `ahead` [m]; return None if no arc leads to it."""
        limits, points = self._limits, inputs.obstacles.points
        aim = min(_MAX_AIM_M, max(_MIN_AIM_M, limits.lookahead * inputs.speed))
        x, y = path_ahead[min(path_ahead.shape[0] - 1, round(aim / SPACING_M))]
        bearing = math.atan2(y, x)
        if self._needs_turn(bearing):
            return VelocityTarget(turn=limits.turn_rate_for(self._same_direction(bearing)))
        end = math.hypot(path_ahead[-1, 0], path_ahead[-1, 1])
        fastest = min(
            limits.speed_to_stop_in(max(left, end)),
            limits.speed_to_stop_in(ahead - self._gap(ahead, left)),
        )
        arc = self._best_arc(path_ahead, aim, points)
        if arc is not None:
            curvature, free, clear = arc
            pace = min(fastest, self._pace(curvature, free, clear))
            self._curvature = curvature
            return VelocityTarget(
                speed=pace if pace < _STANDS else max(pace, _LEAST_SPEED), curvature=curvature
            )
        if abs(inputs.speed) > _SLOW:  # stop first
            return VelocityTarget(curvature=self._curvature)
        direct = np.empty(1)
        check_lines(points, np.array([bearing]), self._room, limits.contact_radius, direct)
        if abs(bearing) > _TURN_TO and direct[0] > min(_ROOM_TO_TURN_M, math.hypot(x, y)):
            self._turning = True
            return VelocityTarget(turn=limits.turn_rate_for(self._same_direction(bearing)))
        return None

    def _follow_detour(self, ahead: float, inputs: PlannerInput) -> VelocityTarget | None:
        """Continue the detour; drop it and return None when it is over or blocked."""
        assert self._detour is not None
        path_ahead = self._detour.ahead(inputs.odom)
        left = self._detour.left
        if left > 2.0 * SPACING_M and (ahead < _AVOID_WITHIN_M or left > _MIN_AIM_M):
            radius = self._limits.keepout_radius - _MARGIN_SHARE * self._limits.margin
            free = free_length(inputs.obstacles.points, path_ahead[:_CHECKED], SPACING_M, radius)
            if free >= min(_AVOID_WITHIN_M, left):
                target = self._follow(path_ahead, left + _DETOUR_GOES_ON_M, UNLIMITED_M, inputs)
                if target is not None:
                    return target
        self._detour = None
        return None

    def _find_detour(self, path_ahead: Array, ahead: float, inputs: PlannerInput) -> bool:
        """Search a detour to the path beyond the obstacle; return whether there is one."""
        self._searched_at = inputs.now
        points = inputs.obstacles.points
        first = 0 if ahead == UNLIMITED_M else round(ahead / SPACING_M)
        run = _REJOIN_POINTS if ahead < UNLIMITED_M else 0
        index = first_free_again(points, path_ahead, first, run, self._limits.keepout_radius)
        if index < 0:
            return False
        targets = path_ahead[index : index + _REJOIN_POINTS + 1]
        near = np.flatnonzero((np.abs(targets) < SEARCH_RANGE_M).all(axis=1))
        if near.size == 0:
            return False
        x, y = targets[near[-1]]
        found = self._search.find(points, x, y)
        if found is None:
            return False
        poses = np.array([compose(inputs.odom, (px, py, 0.0)) for px, py in found])
        self._detour = FollowedPath(poses, compose(inputs.odom, (x, y, 0.0)))
        return True

    def _pace(self, curvature: float, free: float, clear: float) -> float:
        limits = self._limits
        return min(
            limits.speed_to_stop_in(free - _STOP_GAP_M),
            limits.speed_beside(clear - limits.radius),
            limits.speed_in(curvature),
        )

    def _needs_turn(self, bearing: float) -> bool:
        self._turning = abs(bearing) > (_TURN_TO if self._turning else _TURN_FROM)
        if not self._turning:
            self._side = 0.0
        return self._turning

    def _same_direction(self, angle: float) -> float:
        """Return an angle to turn by; about half a turn continues in the current direction."""
        if self._side * angle < 0.0 and abs(angle) > _ABOUT_HALF_A_TURN:
            return angle + math.copysign(2.0 * math.pi, self._side)
        self._side = math.copysign(1.0, angle)
        return angle

    def _check(self, points: Array, curvatures: Array, lengths: Array) -> None:
        limits = self._limits
        check_arcs(
            points, curvatures, lengths, self._room, limits.contact_radius, self._free, self._clear
        )

    def _best_arc(
        self, path_ahead: Array, aim: float, points: Array
    ) -> tuple[float, float, float] | None:
        """Return curvature, free length and clearance of the arc to the farthest point in reach."""
        last = path_ahead.shape[0] - 1
        aims = np.minimum(last, np.rint(_AIM_SHARES * (aim / SPACING_M)).astype(np.int64))
        targets = path_ahead[aims]
        apart = np.maximum(1e-9, targets[:, 0] ** 2 + targets[:, 1] ** 2)
        curvatures = np.clip(2.0 * targets[:, 1] / apart, -_SHARPEST, _SHARPEST)
        halves = np.arctan2(targets[:, 1], targets[:, 0])
        # An arc to a point behind the robot is not used; its length only has to be finite.
        lengths = np.sqrt(apart) / np.maximum(0.1, np.sinc(halves / math.pi))
        self._check(points, curvatures, lengths)
        best = None
        for i in range(_AIM_SHARES.size):
            needed = lengths[i] - (_GOAL_SLACK_M if aims[i] == last else 0.0)
            # A point beside or behind the robot requires turning on the spot.
            if self._free[i] < needed or abs(halves[i]) > _MOST_BEARING:
                continue
            arc = float(curvatures[i]), float(self._free[i]), float(self._clear[i])
            if arc[2] >= self._room + _GOOD_CLEARANCE_M:
                return arc
            if best is None or arc[2] > best[2] + _BETTER_CLEARANCE_M:
                best = arc
        return best


_UNSEEN = "the scanner did not see the ground ahead lately"


def _blocked_reason(ahead: float, inputs: PlannerInput, limits: MotionLimits) -> str:
    if ahead == UNLIMITED_M:
        gap = max(0.0, inputs.obstacles.nearest - limits.radius)
        return f"no room to move: an obstacle is {gap:.2f} m from the robot"
    return f"an obstacle {ahead:.2f} m ahead on the path"
