"""Collision monitor: how much of a velocity command leaves room to stop before the scanned points.

The robot is a circle or a convex polygon in the frame of its base; points (n, 2) [m] are in the
same frame. All functions are pure. Motion away from a point is always allowed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.velocity_gate.limiter import Velocity

Array = NDArray[np.float64]
Corners = tuple[tuple[float, float], ...]

# Speeds [m/s], turn rates [rad/s] and curvatures [1/m] below these count as zero.
_NO_SPEED, _NO_TURN, _STRAIGHT = 1e-4, 1e-4, 1e-3
# A point inside the footprint is approached if it moves toward it in a direction that differs from
# that along its edge by more than this [1, sine]: a robot that drives past a point beside it comes
# nearer by no more than this share of the footprint's size squared over two, a millimeter.
_TOWARD = 0.1
_CIRCLE_CORNERS = 32  # of a round robot's outline in pictures: within 0.5 % of the circle


@dataclass(frozen=True)
class Footprint:
    """The outline of the robot: a circle of `radius` [m], or a convex polygon with `corners`.

    The corners [m] are counterclockwise, around the base's center.
    """

    radius: float
    corners: Corners = ()

    @property
    def is_round(self) -> bool:
        """Whether turning on the spot touches nothing."""
        return not self.corners

    @property
    def reach(self) -> float:
        """Return the distance [m] of its farthest point from the base's center."""
        return max((math.hypot(x, y) for x, y in self.corners), default=self.radius)

    def polygon(self) -> Corners:
        """Return the corners of the outline [m]; of a circle, `_CIRCLE_CORNERS` points on it."""
        if self.corners:
            return self.corners
        angles = [2.0 * math.pi * i / _CIRCLE_CORNERS for i in range(_CIRCLE_CORNERS)]
        return tuple((self.radius * math.cos(a), self.radius * math.sin(a)) for a in angles)

    def inflated(self, margin: float) -> Footprint:
        """Return the footprint with every side moved outward by `margin` [m]."""
        if self.is_round:
            return Footprint(self.radius + margin)
        moved = []
        for before, corner, after in zip(
            (self.corners[-1], *self.corners[:-1]),
            self.corners,
            (*self.corners[1:], self.corners[0]),
            strict=True,
        ):
            (ax, ay), (bx, by) = _normal(before, corner), _normal(corner, after)
            scale = margin / (1.0 + ax * bx + ay * by)
            moved.append((corner[0] + scale * (ax + bx), corner[1] + scale * (ay + by)))
        return Footprint(self.radius, tuple(moved))

    def seconds_to_contact(self, points: Array, velocity: Velocity) -> float:
        """Return how long [s] the robot can keep a velocity until it touches a point.

        Infinite if it touches none; 0 if a point inside the footprint is approached.
        """
        speed, turn = velocity
        if points.shape[0] == 0:
            return math.inf
        if self.is_round:
            if abs(speed) < _NO_SPEED:
                return math.inf
            return _circle_length(points, self.radius, speed, turn) / abs(speed)
        if abs(speed) < _NO_SPEED and abs(turn) < _NO_TURN:
            return math.inf
        return _polygon_seconds(points, np.array(self.corners), speed, turn)


@dataclass(frozen=True)
class StoppingAbility:
    """Decelerations on which the check relies [m/s^2], [rad/s^2]."""

    braking: float
    turn_braking: float


def allowed_share(
    seconds: float, velocity: Velocity, ability: StoppingAbility, reaction_s: float, *, turns: bool
) -> float:
    """Return the share [1] of a velocity from which the robot stops within `seconds` of its arc.

    It drives on for `reaction_s` before it brakes. `turns`: turning must stop, too.
    """
    if math.isinf(seconds):
        return 1.0
    if seconds <= 0.0:
        return 0.0
    speed, turn = abs(velocity[0]), abs(velocity[1])
    rate = math.inf  # of the share [1/s]
    if speed > 0.0:
        rate = ability.braking / speed
    if turns and turn > 0.0:
        rate = min(rate, ability.turn_braking / turn)
    if math.isinf(rate):
        return 1.0
    lag = rate * reaction_s
    return min(1.0, math.sqrt(lag * lag + 2.0 * rate * seconds) - lag)


def convex_corners(corners: Corners) -> Corners:
    """Return corners counterclockwise; `ValueError` unless they are a convex outline of the center.

    Three corners at least; the base's center must be inside.
    """
    if len(corners) < 3:
        raise ValueError(f"footprint has {len(corners)} corners; give at least 3, or none")
    area = sum(
        ax * by - bx * ay
        for (ax, ay), (bx, by) in zip(corners, (*corners[1:], corners[0]), strict=True)
    )
    ordered = corners if area > 0.0 else corners[::-1]
    for index, corner in enumerate(ordered):
        after = ordered[(index + 1) % len(ordered)]
        if math.dist(corner, after) < 1e-3:
            raise ValueError(f"footprint: two corners are at {corner}; remove one of them")
        nx, ny = _normal(corner, after)
        if nx * corner[0] + ny * corner[1] <= 0.0:
            raise ValueError(
                "footprint: the base's center (0, 0) is not inside; correct the corners"
            )
        if any(nx * (x - corner[0]) + ny * (y - corner[1]) > 1e-6 for x, y in ordered):
            raise ValueError(f"footprint is not convex at {after}; give its convex hull")
    return ordered


def _normal(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    """Return the unit normal that points outward from the side from `a` to `b`."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = math.hypot(dx, dy)
    return dy / length, -dx / length


def _circle_length(points: Array, radius: float, speed: float, turn: float) -> float:
    """Return the length [m] of the arc until a circle touches a point."""
    x = points[:, 0] if speed > 0.0 else -points[:, 0]
    y = points[:, 1]
    bend = turn / speed  # mirrored with x for a robot that drives backward
    squared = x * x + y * y
    inside = squared < radius * radius
    if np.any(inside & (x > _TOWARD * np.sqrt(squared))):
        return 0.0
    x, y = x[~inside], y[~inside]
    if abs(bend) < _STRAIGHT:
        hit = (x > 0.0) & (np.abs(y) < radius)
        if not hit.any():
            return math.inf
        return max(0.0, float(np.min(x[hit] - np.sqrt(radius * radius - y[hit] ** 2))))
    middle = 1.0 / abs(bend)
    down = middle - (y if bend > 0.0 else -y)
    apart = np.hypot(x, down)
    hit = np.abs(apart - middle) < radius
    if not hit.any():
        return math.inf
    x, down, apart = x[hit], down[hit], np.maximum(apart[hit], 1e-9)
    cosine = (middle * middle + apart * apart - radius * radius) / (2.0 * middle * apart)
    angle = np.arctan2(x, down) - np.arccos(np.clip(cosine, -1.0, 1.0))
    return middle * float(np.min(angle % (2.0 * math.pi)))


def _polygon_seconds(points: Array, corners: Array, speed: float, turn: float) -> float:
    """Return the time [s] until a convex polygon touches a point."""
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.hypot(sides[:, 0], sides[:, 1])
    along = sides / lengths[:, None]
    normals = np.column_stack((along[:, 1], -along[:, 0]))
    offsets = np.einsum("ij,ij->i", normals, corners)
    outside = points @ normals.T - offsets
    inside = outside.max(axis=1) < 0.0
    if inside.any():
        near = points[inside]
        side = outside[inside].argmax(axis=1)
        motion = np.column_stack((turn * near[:, 1] - speed, -turn * near[:, 0]))
        inward = -np.einsum("ij,ij->i", normals[side], motion)
        if np.any(inward > _TOWARD * np.maximum(1e-9, np.hypot(motion[:, 0], motion[:, 1]))):
            return 0.0
    points, outside = points[~inside], outside[~inside]
    if points.shape[0] == 0:
        return math.inf
    if abs(turn) < max(_NO_TURN, _STRAIGHT * abs(speed)):
        closing = speed * normals[:, 0]  # of the robot's sides toward a point [m/s]
        with np.errstate(divide="ignore", invalid="ignore"):
            times = outside / closing
        enters = np.where(closing > 0.0, times, -math.inf).max(axis=1)
        leaves = np.where(closing < 0.0, times, math.inf).min(axis=1)
        never = np.any((closing == 0.0) & (outside > 0.0), axis=1)
        touched = (enters <= leaves) & (enters >= 0.0) & ~never
        return float(enters[touched].min()) if touched.any() else math.inf
    # In the robot's frame a point turns by -turn around the center of the robot's rotation.
    center = np.array([0.0, speed / turn])
    from_center = points - center
    apart = np.hypot(from_center[:, 0], from_center[:, 1])[:, None]
    start = np.arctan2(from_center[:, 1], from_center[:, 0])[:, None]
    heights = offsets - normals @ center
    with np.errstate(divide="ignore", invalid="ignore"):
        half = np.arccos(heights / apart)  # NaN where the circle does not reach a side's line
    best = math.inf
    directions = np.arctan2(normals[:, 1], normals[:, 0])
    for angle in (directions + half, directions - half):
        x, y = apart * np.cos(angle) + center[0], apart * np.sin(angle) + center[1]
        place = (x - corners[:, 0]) * along[:, 0] + (y - corners[:, 1]) * along[:, 1]
        with np.errstate(invalid="ignore"):
            on_side = (place >= 0.0) & (place <= lengths)
        if on_side.any():
            turned = (math.copysign(1.0, turn) * (start - angle)) % (2.0 * math.pi)
            best = min(best, float(turned[on_side].min()) / abs(turn))
    return best
