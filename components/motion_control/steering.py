"""Makes commands of wishes: within accelerations, and never into what was seen."""

from __future__ import annotations

import math

import numpy as np

from cairn.components.motion_control.arcs import arc_clearances
from cairn.components.motion_control.limits import Limits
from cairn.components.motion_control.local_planner import Wish
from cairn.components.motion_control.seen_space import Surroundings

Command = tuple[float, float]
"""Speed ahead [m/s] and of turning [rad/s]."""

STAND: Command = (0.0, 0.0)

# A command may be this far [s] of acceleration ahead of what odometry measures.
_LEAD_S = 0.3
_LONGEST_STEP_S, _SHORTEST_STEP_S = 0.12, 0.005
_TOUCH = 0.01  # free way [m] that is left over


class Steering:
    """The last command, from which the next one may differ by what accelerations allow."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._command = STAND
        self._at = 0
        self._free = np.empty(1)
        self._clear = np.empty(1)

    def stop(self, now: int) -> Command:
        """Stand at once: the base brakes as hard as it can."""
        self._command, self._at = STAND, now
        return STAND

    def command(self, wish: Wish, now: int, measured: Command, around: Surroundings) -> Command:
        """The next command at `now` [ns], when the robot moves as `measured`."""
        limits = self._limits
        step = min(_LONGEST_STEP_S, max(_SHORTEST_STEP_S, (now - self._at) / 1e9))
        speed, turn = self._command
        lead, turn_lead = limits.acceleration * _LEAD_S, limits.turn_acceleration * _LEAD_S
        speed = min(measured[0] + lead, max(measured[0] - lead, speed))
        turn = min(measured[1] + turn_lead, max(measured[1] - turn_lead, turn))
        change, turn_change = limits.acceleration * step, limits.turn_acceleration * step
        forward = min(speed + change, max(speed - change, wish.speed))
        wanted = wish.turn + wish.curvature * forward
        wanted = min(limits.turn_speed, max(-limits.turn_speed, wanted))
        turned = min(turn + turn_change, max(turn - turn_change, wanted))
        forward = self._guarded(forward, turned, around)
        self._command, self._at = (forward, turned), now
        return self._command

    def _guarded(self, forward: float, turn: float, around: Surroundings) -> float:
        """The speed from which it can still stop before what is on this arc."""
        limits = self._limits
        if abs(forward) < 1e-3 or (forward > 0.0 and not around.seen_ahead):
            return 0.0
        points = around.points
        if forward < 0.0:
            points = points * np.array([-1.0, 1.0])
            turn = -turn
        bend = np.array([turn / abs(forward)])
        arc_clearances(
            points, bend, np.zeros(1), limits.tight, limits.touching, self._free, self._clear
        )
        most = limits.speed_before(self._free[0] - _TOUCH)
        return math.copysign(min(abs(forward), most), forward)
