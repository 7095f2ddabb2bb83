"""Follows a path among obstacles: along it where it is free, around what stands on it, or not.

Pure pursuit of a point ahead on the path (Coulter 1992), regulated in speed by curvature, free
distance and clearance (Macenski et al. 2023). Each arc is checked against what the scanner sees, as
in the dynamic window approach (Fox, Burgard, Thrun 1997).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.motion_control.arcs import (
    FAR,
    arc_clearances,
    free_again,
    free_along,
    open_ways,
)
from cairn.components.motion_control.detour import WITHIN, DetourSearch
from cairn.components.motion_control.limits import Limits
from cairn.components.motion_control.route import AHEAD, SPACING, Route
from cairn.components.motion_control.seen_space import Surroundings
from cairn.planar.poses import Pose, compose

Array = NDArray[np.float64]

LOOK = AHEAD + 0.3
"""Obstacles within this distance [m] of the robot are to be given."""

_NEAREST_AIM, _FARTHEST_AIM = 0.35, 0.8  # [m] along the path
_AIMS = np.array([1.0, 0.75, 0.55, 0.4])  # shares of it that are tried where there is no room
# Turning on the spot begins when the path is this far off the heading, and ends here [rad].
_TURN_FROM, _TURN_TO = 1.0, 0.2
# What blocks the path nearer than this [m] is gone around.
_AVOID = 1.4
_CHECKED = round(_AVOID / SPACING) + 2
_AT_GOAL = 0.3  # what is no farther than this before the goal [m] is gone up to
_NEARLY = 0.06  # [m] that the goal itself may be beyond reach
_REJOIN = 16  # points of the path that must be free beyond what blocks it
_AGAIN_NS = 300_000_000  # how long no detour is looked for after there was none
_GRACE = 0.6  # share of the margin that noise may take from a detour before it is given up
_TOUCH = 0.02  # free way [m] that is left over where the robot stops
_STRAIGHT_SPEED = 0.25  # [m/s] where there is no path
_LEAST_SPEED = 0.05  # [m/s] that a base can follow


@dataclass(frozen=True)
class Wish:
    """A motion wanted: speed [m/s] and curvature [1/m], or turning on the spot [rad/s].

    `blocked` says why there is none; empty if there is.
    """

    speed: float = 0.0
    curvature: float = 0.0
    turn: float = 0.0
    blocked: str = ""


STILL = Wish()


@dataclass(frozen=True)
class Place:
    """Where the robot is in the odometry frame at `now` [ns], its speed [m/s], what is around."""

    now: int
    odom: Pose
    speed: float
    around: Surroundings


class LocalPlanner:
    """Follows the way ahead among obstacles; keeps what it has begun, so as not to waver."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._room = limits.kept
        self._turning = False
        self._side = 0.0
        self._curvature = 0.0
        self._detour: Route | None = None
        self._sought_at = -_AGAIN_NS
        self._search = DetourSearch(limits)
        self._free = np.empty(_AIMS.size)
        self._clear = np.empty(_AIMS.size)

    def along(self, way: Array, left: float, place: Place) -> Wish:
        """The motion along `way` (n, 2) [m], its points `SPACING` apart, in the robot's frame.

        `left` [m] is the path's length from here to its end.
        """
        wish = self._free_of(way, left, place)
        if wish.speed > 0.0 and not place.around.seen_ahead:
            return Wish(blocked=_UNSEEN)
        return wish

    def _free_of(self, way: Array, left: float, place: Place) -> Wish:
        self._room = self._limits.kept
        ahead = self._ahead(way, place)
        if self._detour is not None:
            wish = self._round_about(ahead, place)
            if wish is not None:
                return wish
        if ahead >= min(_AVOID, left):
            wish = self._follow(way, left, ahead, place)
            if wish is not None:
                return wish
        if place.now - self._sought_at >= _AGAIN_NS and self._seek(way, ahead, place):
            wish = self._round_about(ahead, place)
            if wish is not None:
                return wish
        self._room = self._limits.tight
        ahead = self._ahead(way, place)
        wish = None
        if ahead >= self._gap(ahead, left):
            wish = self._follow(way, left, ahead, place)
        if wish is None or (wish.speed < 0.01 and wish.turn == 0.0):
            return Wish(curvature=self._curvature, blocked=_told(ahead, place, self._limits))
        return wish

    def _gap(self, ahead: float, left: float) -> float:
        """How far [m] to stay from what is on the path: little where the goal is right at it."""
        return self._limits.stop_distance if left - ahead > _AT_GOAL else min(_TOUCH, left)

    def _ahead(self, way: Array, place: Place) -> float:
        """How far [m] the way is free, `FAR` if nothing is on its first part."""
        return free_along(place.around.points, way[:_CHECKED], SPACING, self._room)

    def straight(self, around: Surroundings, off: float, left: float) -> Wish:
        """The motion straight on for `left` [m] in a direction `off` [rad] the heading."""
        self._turning = abs(off) > (0.5 * _TURN_TO if self._turning else _TURN_TO)
        if self._turning:
            return Wish(turn=self._limits.turn_by(self._the_same_way(off)))
        if not around.seen_ahead:
            return Wish(blocked=_UNSEEN)
        curvature = max(-1.0, min(1.0, 2.0 * off))
        self._check(around.points, np.array([curvature]), np.array([0.3]))
        pace = self._pace(curvature, self._free[0], self._clear[0])
        pace = min(_STRAIGHT_SPEED, self._limits.speed_before(left), pace)
        if pace <= 0.01:
            gap = max(0.0, around.nearest - self._limits.radius)
            return Wish(blocked=f"an obstacle {gap:.2f} m from the robot")
        return Wish(speed=max(_LEAST_SPEED, pace), curvature=curvature)

    def _follow(self, way: Array, left: float, ahead: float, place: Place) -> Wish | None:
        """Pursue a way that is free for `ahead` [m]; None if no arc leads on to it."""
        limits, points = self._limits, place.around.points
        aim = min(_FARTHEST_AIM, max(_NEAREST_AIM, limits.lookahead * place.speed))
        x, y = way[min(way.shape[0] - 1, round(aim / SPACING))]
        bearing = math.atan2(y, x)
        if self._turns(bearing):
            return Wish(turn=limits.turn_by(self._the_same_way(bearing)))
        end = math.hypot(way[-1, 0], way[-1, 1])
        fastest = min(
            limits.speed_before(max(left, end)),
            limits.speed_before(ahead - self._gap(ahead, left)),
        )
        arc = self._pursue(way, aim, points)
        if arc is not None:
            curvature, free, clear = arc
            pace = min(fastest, self._pace(curvature, free, clear))
            self._curvature = curvature
            return Wish(speed=pace if pace < 0.01 else max(pace, _LEAST_SPEED), curvature=curvature)
        if abs(place.speed) > 0.05:  # first it stands
            return Wish(curvature=self._curvature)
        direct = np.empty(1)
        open_ways(points, np.array([bearing]), self._room, limits.touching, direct)
        if abs(bearing) > _TURN_TO and direct[0] > min(0.3, math.hypot(x, y)):
            self._turning = True
            return Wish(turn=limits.turn_by(self._the_same_way(bearing)))
        return None

    def _round_about(self, ahead: float, place: Place) -> Wish | None:
        """Go on with the detour; None, and it is given up, when it is over or blocked."""
        assert self._detour is not None
        way = self._detour.ahead(place.odom)
        left = self._detour.left
        if left > 2.0 * SPACING and (ahead < _AVOID or left > _NEAREST_AIM):
            radius = self._limits.kept - _GRACE * self._limits.margin
            free = free_along(place.around.points, way[:_CHECKED], SPACING, radius)
            if free >= min(_AVOID, left):
                wish = self._follow(way, left + 0.5, FAR, place)
                if wish is not None:
                    return wish
        self._detour = None
        return None

    def _seek(self, way: Array, ahead: float, place: Place) -> bool:
        """Look for a detour to the path beyond what blocks it."""
        self._sought_at = place.now
        points = place.around.points
        first = 0 if ahead == FAR else round(ahead / SPACING)
        run = _REJOIN if ahead < FAR else 0
        index = free_again(points, way, first, run, self._limits.kept)
        if index < 0:
            return False
        targets = way[index : index + _REJOIN + 1]
        near = np.flatnonzero((np.abs(targets) < WITHIN).all(axis=1))
        if near.size == 0:
            return False
        x, y = targets[near[-1]]
        found = self._search.find(points, x, y)
        if found is None:
            return False
        poses = np.array([compose(place.odom, (px, py, 0.0)) for px, py in found])
        self._detour = Route(poses, compose(place.odom, (x, y, 0.0)))
        return True

    def _pace(self, curvature: float, free: float, clear: float) -> float:
        limits = self._limits
        return min(
            limits.speed_before(free - _TOUCH),
            limits.speed_beside(clear - limits.radius),
            limits.speed_in(curvature),
        )

    def _turns(self, bearing: float) -> bool:
        self._turning = abs(bearing) > (_TURN_TO if self._turning else _TURN_FROM)
        if not self._turning:
            self._side = 0.0
        return self._turning

    def _the_same_way(self, angle: float) -> float:
        """An angle to turn by, the way round that was begun, when it is about half a turn."""
        if self._side * angle < 0.0 and abs(angle) > 2.0:
            return angle + math.copysign(2.0 * math.pi, self._side)
        self._side = math.copysign(1.0, angle)
        return angle

    def _check(self, points: Array, curvatures: Array, lengths: Array) -> None:
        limits = self._limits
        arc_clearances(
            points, curvatures, lengths, self._room, limits.touching, self._free, self._clear
        )

    def _pursue(self, way: Array, aim: float, points: Array) -> tuple[float, float, float] | None:
        """Curvature, free way and clearance of the arc to the farthest point that it can reach."""
        last = way.shape[0] - 1
        aims = np.minimum(last, np.rint(_AIMS * (aim / SPACING)).astype(np.int64))
        targets = way[aims]
        apart = np.maximum(1e-9, targets[:, 0] ** 2 + targets[:, 1] ** 2)
        curvatures = np.clip(2.0 * targets[:, 1] / apart, -8.0, 8.0)
        halves = np.arctan2(targets[:, 1], targets[:, 0])
        lengths = np.sqrt(apart) / np.maximum(0.1, np.sinc(halves / math.pi))
        self._check(points, curvatures, lengths)
        best = None
        for i in range(_AIMS.size):
            needed = lengths[i] - (_NEARLY if aims[i] == last else 0.0)
            # An aim beside or behind the robot is for turning on the spot.
            if self._free[i] < needed or abs(halves[i]) > 1.3:
                continue
            arc = float(curvatures[i]), float(self._free[i]), float(self._clear[i])
            if arc[2] >= self._room + 0.05:
                return arc
            if best is None or arc[2] > best[2] + 0.01:
                best = arc
        return best


_UNSEEN = "the scanner did not see lately what is ahead"


def _told(ahead: float, place: Place, limits: Limits) -> str:
    if ahead == FAR:
        gap = max(0.0, place.around.nearest - limits.radius)
        return f"no room to move: an obstacle is {gap:.2f} m from the robot"
    return f"an obstacle {ahead:.2f} m ahead on the path"
