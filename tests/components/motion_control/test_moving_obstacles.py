"""Moving obstacles are detected and predicted."""

import math

import numpy as np

from cairn import SECOND
from cairn.components.motion_control.moving_obstacles import MovingObstacleTracker
from cairn.planar.poses import Pose
from tests.components.motion_control.world import Array, Disc, World, box, rays_from

ANGLES = np.linspace(-math.pi, math.pi, 360, endpoint=False)
HALL = box(0, 0, 12, 12)


def looked(
    world: World, times: np.ndarray, robot: Pose = (0, 0, 0), speed: float = 0.0
) -> list[Array]:
    """The predictions after each scan while the robot drives straight ahead."""
    movers, random = MovingObstacleTracker(), np.random.default_rng(0)
    expected = []
    for time in times.tolist():
        at = (robot[0] + speed * time, robot[1], robot[2])
        ranges = world.ranges(time, at, ANGLES, random.normal(0, 0.01, ANGLES.size))
        rays = rays_from(at, ANGLES, ranges)
        expected.append(movers.add_scan(round(time * SECOND), rays, 0.0))
    return expected


def test_position_of_a_walking_person_is_predicted() -> None:
    def person(time: float) -> list[Disc]:
        return [(2.0, -1.5 + 1.0 * time, 0.25)]

    last = looked(World(HALL, person), np.arange(0, 1.5, 0.1))[-1]

    soon, late = last[last[:, 2] < 0.25], last[last[:, 2] > 1.35]
    assert np.abs(soon[:, 1].mean() - (-1.5 + 1.4 + 0.2)) < 0.15
    assert np.abs(late[:, 1].mean() - (-1.5 + 1.4 + 1.4)) < 0.25
    assert np.abs(last[:, 0] - 1.8).max() < 0.3


def test_moving_things_are_listed_with_position_and_direction() -> None:
    def person_and_pillar(time: float) -> list[Disc]:
        return [(2.0, -1.5 + 1.0 * time, 0.25), (-3.0, 1.0, 0.2)]

    world, robot, movers = World(HALL, person_and_pillar), (0.0, 0.0, 0.0), MovingObstacleTracker()
    for time in np.arange(0, 1.5, 0.1).tolist():
        rays = rays_from(robot, ANGLES, world.ranges(time, robot, ANGLES, np.zeros(ANGLES.size)))
        movers.add_scan(round(time * SECOND), rays, 0.0)

    ((x, y, direction),) = movers.moving()

    assert math.hypot(x - 1.8, y + 0.1) < 0.2
    assert abs(direction - math.pi / 2) < 0.2
    movers.forget()
    assert movers.moving().shape == (0, 3)


def test_walking_person_is_detected_within_half_a_second() -> None:
    def person(time: float) -> list[Disc]:
        return [(2.0, -1.5 + 1.0 * time, 0.25)]

    expected = looked(World(HALL, person), np.arange(0, 1.0, 0.1))

    assert next(k for k, rows in enumerate(expected) if len(rows)) <= 5


def test_moving_robot_detects_no_motion_of_standing_things() -> None:
    things = [
        *box(1, 1, 0.4, 0.4),
        *box(2.5, -0.8, 0.2, 0.6),
        *box(3, 1.5, 0.1, 0.1),
        (0.0, 2.0, 4.0, 2.0),
    ]

    def pillar(_: float) -> list[Disc]:
        return [(1.8, -0.7, 0.15)]

    expected = looked(World(HALL + things, pillar), np.arange(0, 5, 0.1), (-1, 0, 0), 0.6)

    assert sum(len(rows) for rows in expected) == 0


def test_repeated_scan_changes_nothing() -> None:
    def person(time: float) -> list[Disc]:
        return [(2.0, -1.5 + 1.0 * time, 0.25)]

    twice = looked(World(HALL, person), np.repeat(np.arange(0, 1.5, 0.3), 2))

    assert len(twice[-1]) > 0
    for first, again in zip(twice[0::2], twice[1::2], strict=True):
        assert np.array_equal(first, again)


def test_moving_things_are_detected_after_a_time_reset() -> None:
    def person(time: float) -> list[Disc]:
        return [(2.0, -1.5 + 1.0 * time, 0.25)]

    times = np.concatenate((np.arange(100, 101, 0.1), np.arange(0, 1.0, 0.1)))

    assert len(looked(World(HALL, person), times)[-1]) > 0


def test_moving_things_are_forgotten() -> None:
    movers = MovingObstacleTracker()
    world = World(HALL, lambda time: [(2.0, -1 + time, 0.25)])
    for k in range(8):
        ranges = world.ranges(0.1 * k, (0, 0, 0), ANGLES, np.zeros(ANGLES.size))
        rays = rays_from((0, 0, 0), ANGLES, ranges)
        rows = movers.add_scan(k * SECOND // 10, rays, 0.0)
    assert len(rows) > 0

    movers.forget()

    assert len(movers.add_scan(2 * SECOND, rays, 0.0)) == 0
