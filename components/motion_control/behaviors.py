"""What motion control can be wanted to do: follow, back off, look around, explore."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np

from cairn.components.motion_control.arcs import arc_clearances, open_ways
from cairn.components.motion_control.limits import Limits
from cairn.components.motion_control.local_planner import STILL, LocalPlanner, Place, Wish
from cairn.components.motion_control.route import Route
from cairn.components.motion_control.seen_space import SeenSpace, Surroundings
from cairn.planar.poses import Pose, compose, distance, relative, wrap
from cairn.schemas.cairn_nav_msgs import MotionStatus, ReasonCode

SECOND_NS = 1_000_000_000


class State(IntEnum):
    """State of a motion, with the numbers of its message."""

    STANDING = MotionStatus.STANDING
    MOVING = MotionStatus.MOVING
    BLOCKED = MotionStatus.BLOCKED
    DONE = MotionStatus.DONE
    STOPPED = MotionStatus.STOPPED


@dataclass(frozen=True)
class Situation:
    """What is known at `now` [ns]: poses in the odometry frame and in the map, and obstacles.

    `speed` [m/s] and `turn` [rad/s] are measured; `pose` is None where it is unknown; `view` is the
    part of a circle around the robot that the scanner sees: its middle and half its width [rad].
    """

    now: int
    odom: Pose
    speed: float
    turn: float
    pose: Pose | None
    space: SeenSpace
    around: Surroundings
    view: tuple[float, float] = (0.0, math.pi)

    @property
    def place(self) -> Place:
        """The part of it that the local planner needs."""
        return Place(self.now, self.odom, self.speed, self.around)

    @property
    def stands(self) -> bool:
        """Whether the robot does not move any more, but for its odometry's noise."""
        return abs(self.speed) < 0.03 and abs(self.turn) < 0.06


@dataclass(frozen=True)
class Motion:
    """The velocity to drive at now, its reason, and the distance `left` [m] still to go."""

    wish: Wish = STILL
    state: State = State.MOVING
    reason: str = ""
    left: float = 0.0
    code: int = ReasonCode.NONE


class Behavior(Protocol):
    """One thing to do, until it is DONE."""

    def step(self, situation: Situation) -> Motion:
        """What to do now."""
        ...


class Follow:
    """Follows a path in the map to its goal, then turns to the goal's heading.

    It is there within `position` [m] and `heading` [rad]; it aims at a third of these.
    """

    # A path so far away [m] is not gone to.
    OFF = 2.5
    # It is called blocked when there was nothing to do for so long [ns].
    PATIENCE_NS = SECOND_NS // 2

    def __init__(self, limits: Limits, route: Route, position: float, heading: float) -> None:
        self._limits = limits
        self._planner = LocalPlanner(limits)
        self._position = max(0.02, position)
        self._heading = max(0.02, heading)
        self._arrived = self._done = False
        self._moved_at = 0
        self.route = route

    def step(self, situation: Situation) -> Motion:
        """What to do now; the situation must have a pose."""
        pose, goal = situation.pose, self.route.goal
        assert pose is not None
        apart = distance(pose, goal)
        if self._done:
            return Motion(state=State.DONE)
        if not self._arrived:
            ahead = relative(pose, goal)[0]
            self._arrived = apart < 0.35 * self._position or (
                apart < 0.7 * self._position and ahead < 0.02
            )
        elif apart > 0.9 * self._position:
            self._arrived = False
        if self._arrived:
            return self._turn(situation, apart, wrap(goal[2] - pose[2]))
        way = self.route.ahead(pose)
        left = max(self.route.left, apart) if self.route.left < 0.5 else self.route.left
        if self.route.off > self.OFF:
            reason = f"the path is {self.route.off:.1f} m away"
            return Motion(state=State.BLOCKED, reason=reason, left=left, code=ReasonCode.OFF_PATH)
        wish = self._planner.along(way, left, situation.place)
        if wish.blocked and apart < 0.9 * self._position:
            self._arrived = True
        if not wish.blocked:
            self._moved_at = situation.now
        if situation.now - self._moved_at < self.PATIENCE_NS:
            return Motion(wish, State.MOVING, wish.blocked, left, _code(wish))
        return _moving(wish, left)

    def _turn(self, situation: Situation, apart: float, off: float) -> Motion:
        if abs(off) > 0.35 * self._heading:
            return Motion(Wish(turn=self._limits.turn_by(off)), left=apart)
        self._done = situation.stands
        return Motion(state=State.DONE if self._done else State.MOVING, left=apart)


class BackOff:
    """Goes back a little: backwards where that was seen lately, else turned about and ahead."""

    SPEED = 0.15  # [m/s]
    SEEN_NS = 4 * SECOND_NS
    # With less than this [m] behind the robot it does not begin; it goes this far [m] to be done.
    _LEAST, _WORTH = 0.03, 0.05

    def __init__(self, limits: Limits, length: float = 0.3) -> None:
        self._limits = limits
        self._length = length
        self._start: Pose | None = None
        self._about: LocalPlanner | None = None
        self._zero = np.zeros(1)
        self._free = np.empty(1)
        self._clear = np.empty(1)
        self._end: Motion | None = None

    def step(self, situation: Situation) -> Motion:
        """What to do now."""
        if self._start is None:
            self._start = situation.odom
        if self._end is not None and self._end.state is State.DONE:
            return self._end
        gone = distance(self._start, situation.odom)
        left = self._length - gone
        if left <= 0.01:
            return self._ended(State.DONE, "")
        if self._about is not None:
            return self._turned_about(self._about, situation, gone, left)
        limits = self._limits
        points = situation.around.points * -1.0
        arc_clearances(
            points, self._zero, self._zero, limits.kept, limits.touching, self._free, self._clear
        )
        free = float(self._free[0])
        if free < self._LEAST:
            return self._hindered(gone, f"an obstacle {free + limits.margin:.2f} m behind")
        since = situation.now - self.SEEN_NS
        if not situation.space.is_seen(situation.odom, math.pi, min(left, free), since):
            self._about = LocalPlanner(limits)
            return self._turned_about(self._about, situation, gone, left)
        pace = min(self.SPEED, limits.speed_before(left), limits.speed_before(free - 0.02))
        return Motion(Wish(speed=-max(0.04, pace)), left=left)

    def _turned_about(
        self, planner: LocalPlanner, situation: Situation, gone: float, left: float
    ) -> Motion:
        assert self._start is not None
        off = wrap(self._start[2] + math.pi - situation.odom[2])
        wish = planner.straight(situation.around, off, left)
        if wish.blocked:
            return self._hindered(gone, wish.blocked)
        return _moving(wish, left)

    def _hindered(self, gone: float, reason: str) -> Motion:
        if gone >= self._WORTH:
            return self._ended(State.DONE, f"{gone:.2f} m back: {reason}")
        return self._ended(State.BLOCKED, reason)

    def _ended(self, state: State, reason: str) -> Motion:
        code = ReasonCode.OBSTACLE if reason else ReasonCode.NONE
        self._end = Motion(state=state, reason=reason, code=code)
        return self._end


class LookAround:
    """Turns once around on the spot."""

    SPEED = 0.8  # [rad/s]

    def __init__(self, limits: Limits, angle: float = 2.0 * math.pi) -> None:
        self._limits = limits
        self._left = angle
        self._heading: float | None = None

    def step(self, situation: Situation) -> Motion:
        """What to do now."""
        heading = situation.odom[2]
        if self._heading is not None:
            self._left -= wrap(heading - self._heading)
        self._heading = heading
        if self._left <= 0.02:
            return Motion(state=State.DONE)
        return Motion(Wish(turn=min(self.SPEED, self._limits.turn_by(self._left))))


class Explore:
    """Goes `length` [m] toward where there is most room."""

    # There must be so much room [m] to set out; it keeps so far [m] from what ends the room.
    _ROOM, _APART = 0.6, 0.3
    _DIRECTIONS = np.linspace(-math.pi, math.pi, 72, endpoint=False)
    _PATIENCE_NS = 1 * SECOND_NS
    _TRIES = 4
    REACH = 4.0

    def __init__(self, limits: Limits, length: float) -> None:
        self._limits = limits
        self._left = length
        self._planner = LocalPlanner(limits)
        self._route: Route | None = None
        self._look: LookAround | None = None
        self._odom: Pose | None = None
        self._tries = 0
        self._moved_at: int | None = None
        self._free = np.empty(self._DIRECTIONS.size)

    def step(self, situation: Situation) -> Motion:
        """What to do now."""
        gone = 0.0 if self._odom is None else distance(self._odom, situation.odom)
        self._odom = situation.odom
        self._left -= gone
        if self._left <= 0.0:
            return Motion(state=State.DONE)
        if self._look is not None:
            looked = self._look.step(situation)
            if looked.state is not State.DONE:
                return Motion(
                    looked.wish, State.MOVING, "looking for room", self._left, ReasonCode.NO_ROOM
                )
            self._look = None
        if self._route is None:
            return self._choose(situation)
        way = self._route.ahead(situation.odom)
        if self._route.left < 0.1:
            self._route = None
            return Motion(left=self._left)
        wish = self._planner.along(way, self._route.left, situation.place)
        if not wish.blocked:
            self._moved_at = situation.now
        elif situation.now - (self._moved_at or 0) > self._PATIENCE_NS:
            self._route = None
        return Motion(wish, State.MOVING, wish.blocked, self._left, _code(wish))

    def _choose(self, situation: Situation) -> Motion:
        """Set out in the direction of most room among those seen; or look behind; or give up."""
        if self._tries == self._TRIES:
            reason = f"no room of {self._ROOM:.1f} m to go to"
            return Motion(
                state=State.BLOCKED, reason=reason, left=self._left, code=ReasonCode.NO_ROOM
            )
        self._tries += 1
        limits = self._limits
        points = situation.space.around(situation.odom, self.REACH).points
        open_ways(points, self._DIRECTIONS, limits.kept, limits.touching, self._free)
        free = np.minimum(self._free, 3.0)
        wide = np.minimum(free, np.minimum(np.roll(free, 1), np.roll(free, -1)))
        middle, half = situation.view
        seen = np.abs((self._DIRECTIONS - middle + math.pi) % (2 * math.pi) - math.pi) <= half
        worth = np.where(seen, wide - 0.1 * np.abs(self._DIRECTIONS), -np.inf)
        best = int(np.argmax(worth))
        if wide[best] < self._ROOM or not seen[best]:
            self._look = LookAround(self._limits, math.pi)
            return Motion(left=self._left)
        length = min(self._left + 0.1, wide[best] - self._APART)
        direction = float(self._DIRECTIONS[best])
        end = compose(
            situation.odom,
            (length * math.cos(direction), length * math.sin(direction), direction),
        )
        self._route = Route(np.array([situation.odom, end]), end)
        self._moved_at = situation.now
        return Motion(left=self._left)


def _moving(wish: Wish, left: float) -> Motion:
    state = State.BLOCKED if wish.blocked else State.MOVING
    return Motion(wish, state, wish.blocked, max(0.0, left), _code(wish))


def _code(wish: Wish) -> ReasonCode:
    return ReasonCode.OBSTACLE if wish.blocked else ReasonCode.NONE
