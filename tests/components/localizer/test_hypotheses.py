"""Hypotheses of where the robot is: what makes them arise, and when one of them is believed."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from cairn.components.localizer import hypotheses
from cairn.components.localizer.global_search import PARTICLES, GlobalSearchResult
from cairn.components.localizer.hypotheses import PoseHypotheses
from cairn.components.localizer.likelihood_field import LikelihoodField
from cairn.components.localizer.observations import Landmark
from cairn.components.localizer.particle_set import ParticleSet, PoseEstimate
from cairn.components.localizer.recent_observations import ConfirmationHistory, PoseSupport
from cairn.components.localizer.scan_fit import ScanFit
from cairn.planar.grid import FREE, OccupancyCells
from cairn.planar.motion_model import MEASURED, OdometryStep
from cairn.planar.poses import Pose
from cairn.schemas.cairn_nav_msgs import ReasonCode
from tests.components.localizer.room import apart, drive, room
from tests.components.localizer.test_global_search import robot, through

HERE: Pose = (0.0, 0.0, 0.0)
THERE: Pose = (5.0, 9.0, 0.0)
BEHIND: Pose = (-4.0, -9.0, 0.0)
SMALL = np.eye(3) * 1e-4
STEP_M = 0.1


@dataclass(frozen=True)
class Measurements:
    """Recent measurements of which a scan fits at each place by so many nats."""

    at_places: dict[Pose, float]
    places: float = 1000.0
    scanned: bool = True
    fits: float = 0.9

    def fit(self, _: PoseEstimate) -> float:
        return self.fits

    def support(self, _: PoseEstimate) -> PoseSupport:
        return PoseSupport(0, 0)

    def scan_worth(self, poses: np.ndarray) -> np.ndarray:
        return 0.1 * self.log_likelihood(poses)

    def object_worth(self, poses: np.ndarray) -> np.ndarray:
        return np.zeros(poses.shape[1])

    def log_likelihood(self, poses: np.ndarray) -> np.ndarray:
        # The robot drives along x: it stays nearest in y to the place where it began.
        places = (HERE, THERE, BEHIND)
        nearest = np.argmin([np.abs(poses[1] - place[1]) for place in places], axis=0)
        nats = np.array([self.at_places.get(place, 0.0) for place in places])
        chosen: np.ndarray = nats[nearest]
        return chosen


class Robot:
    """A robot that drives ahead from HERE, while a search finds the other places."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *found: Pose) -> None:
        self.random = np.random.default_rng(0)
        self.particles = ParticleSet(200, 200, MEASURED, self.random)
        self.particles.set_gaussian(HERE, SMALL)
        self.hypotheses = PoseHypotheses(1000, MEASURED, self.random)
        self.found = found
        self.fit = ScanFit()
        self.way_m = 0.0
        monkeypatch.setattr(hypotheses, "search", lambda *_: self._result())

    def _result(self) -> GlobalSearchResult:
        spread = 0.05 * self.random.standard_normal((3, PARTICLES))
        modes = [np.array([[x + self.way_m], [y], [theta]]) + spread for x, y, theta in self.found]
        pose = PoseEstimate(self.found[0], SMALL)
        return GlobalSearchResult(modes, pose, 0.9, PoseSupport(0, 0), np.hstack(modes))

    def search(self, seen: Any, at_once: bool = False) -> None:
        self.hypotheses.search(self.way_m, seen, self.particles.estimate(), at_once)

    def drive(self, seen: Any, far_m: float) -> Pose | None:
        """Drive so far; return where the robot is found, if it is found elsewhere."""
        for _ in range(round(far_m / STEP_M)):
            step = OdometryStep(STEP_M, 0.0, 0.0, 1.0)
            self.way_m += STEP_M
            self.particles.move(step)
            self.hypotheses.move(step)
            self.hypotheses.add_scan(seen.log_likelihood, lambda _: 0.0, self.particles)
            if (moved := self.judge(seen)) is not None:
                return moved
        return None

    def judge(self, seen: Any) -> Pose | None:
        here = self.particles.estimate()
        self.hypotheses.drop_near(seen, here)
        poses = self.hypotheses.take_better(seen, here, self.particles, self.fit)
        if poses is None:
            return None
        self.particles.set_particles(poses)
        return self.particles.estimate().mean


def test_better_fit_of_a_moment_moves_no_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Robot(monkeypatch, THERE)
    # Beams are explained there, and not here, as beside a gap of the map.
    better = Measurements({THERE: 30.0})
    robot.search(better)

    assert robot.judge(better) is None
    assert robot.drive(better, 1.0) is None
    # From then on it is the other way round.
    assert robot.drive(Measurements({HERE: 30.0}), 10.0) is None


def test_better_fit_over_a_distance_moves_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Robot(monkeypatch, THERE)
    better = Measurements({THERE: 30.0})
    robot.search(better)

    moved = robot.drive(better, 15.0)

    assert moved is not None
    assert moved[1] == pytest.approx(THERE[1], abs=2.0)
    assert robot.way_m > 2.0


def test_robot_whose_scans_changed_at_once_is_found_sooner(monkeypatch: pytest.MonkeyPatch) -> None:
    ways = []
    for at_once in (False, True):
        robot = Robot(monkeypatch, THERE)
        better = Measurements({THERE: 30.0})
        robot.search(better, at_once)
        robot.drive(better, 15.0)
        ways.append(robot.way_m)

    assert ways[1] < ways[0]


def test_lookalike_positions_are_reported_and_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Robot(monkeypatch, THERE, BEHIND)
    better = Measurements({THERE: 30.0, BEHIND: 30.0})
    robot.search(better)

    assert robot.drive(better, 8.0) is None
    assert probabilities(robot) == pytest.approx([0.5, 0.5], abs=0.1)
    # Where they differ, one of them is believed.
    moved = robot.drive(Measurements({THERE: 30.0}), 10.0)
    assert moved is not None
    assert moved[1] == pytest.approx(THERE[1], abs=2.0)


def test_robot_goes_on_from_a_likely_position_when_its_own_is_refuted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = Robot(monkeypatch, THERE, BEHIND)
    better = Measurements({THERE: 30.0, BEHIND: 30.0})
    robot.search(better)

    moved = robot.drive(better, 20.0)

    assert moved is not None
    assert probabilities(robot)[0] == pytest.approx(0.5, abs=0.1)


def probabilities(robot: Robot) -> list[float]:
    seen: Any = Measurements({})
    others = robot.hypotheses.alternatives(seen, robot.particles.estimate())
    return [one.probability for one in others]


def test_position_where_scans_fit_less_than_usual_is_not_believed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = Robot(monkeypatch, THERE)
    robot.fit.usual = 0.9
    better = Measurements({THERE: 30.0}, fits=0.6)
    robot.search(better)

    assert robot.drive(better, 15.0) is None


def test_robot_that_was_moved_wrongly_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Robot(monkeypatch, THERE)
    better = Measurements({THERE: 30.0})
    robot.search(better)
    assert robot.drive(better, 15.0) is not None

    back = robot.drive(Measurements({HERE: 30.0}), 15.0)

    assert back is not None
    assert back[1] == pytest.approx(HERE[1], abs=2.0)


def room_with_a_gap() -> OccupancyCells:
    """The room without what stands in its right half."""
    grid = room()
    grid.values[:, 100:] = np.where(grid.values[:, 100:] > 50, FREE, grid.values[:, 100:])
    return grid


@pytest.mark.parametrize("seed", range(2))
def test_gap_in_the_map_moves_no_robot(seed: int) -> None:
    start = (2.0, 2.0, 0.0)
    one = robot(room_with_a_gap(), seed)
    one.set_pose(start, SMALL)

    for moment in drive(room(), start, 40.0, seed):
        through(one, moment)
        assert apart(one.pose().mean, moment.pose)[0] < 1.0


def test_beams_through_walls_explain_nothing() -> None:
    field = LikelihoodField(room(), 0.1, 0.05)
    # The walls at the right and at the left, from between them and from behind the box.
    points = np.array([[2.95, 0.0], [6.9, 0.0]])

    assert field.through_walls((6.0, 3.3, 0.0), points[:1]) == 0.0
    assert field.through_walls((2.05, 3.3, 0.0), points[1:]) < -2.0


def test_kidnapped_robot_stays_in_doubt_while_scans_fit_badly() -> None:
    field = LikelihoodField(room(), 0.1, 0.05)
    one = ScanFit()

    def scans(count: int, share: float) -> None:
        hits = np.array([[2.95 if k < 100 * share else 1.5, 0.0] for k in range(100)])
        for _ in range(count):
            one.update(0.0, field, (6.0, 2.0, 0.0), hits, 100, np.empty((0, 2)), np.empty((0, 2)))

    scans(300, 0.95)
    assert not one.lost

    scans(100, 0.55)
    assert one.lost
    assert one.lost_at_once


def test_reason_names_the_position_that_looks_alike() -> None:
    grid = room(())  # turned half round it looks the same
    one = robot(grid)
    one.set_pose((4.5, 1.0, 0.0), SMALL)

    for moment in drive(grid, (3.0, 2.0, 0.3), 25.0):  # it was carried there
        through(one, moment)

    x, y, _ = one.pose().mean
    (other, *_) = one.alternatives()
    assert math.hypot(other.pose[0] - 9.0 + x, other.pose[1] - 7.0 + y) < 0.5
    reason = one.health().reason
    assert reason.code == ReasonCode.UNCONFIRMED
    assert f"({other.pose[0]:.1f} m, {other.pose[1]:.1f} m)" in reason.text


AT_ORIGIN, BESIDE, FAR = Landmark(1, 0.0, 0.0), Landmark(2, 0.4, 0.0), Landmark(3, 4.0, 0.0)
MAP = {mark.object_id: mark for mark in (AT_ORIGIN, BESIDE, FAR)}


def until(*agreed: tuple[float, int]) -> float:
    history = ConfirmationHistory()
    for stamp, object_id in agreed:
        history.add(stamp, [object_id])
    history.on_pose_replaced(MAP)
    return history.confirmed_until


def test_confirmed_until_the_earlier_of_two_newest_agreements() -> None:
    assert until((1.0, 3), (2.0, 1), (3.0, 3)) == 2.0


def test_one_agreeing_object_does_not_confirm_the_pose() -> None:
    assert until((1.0, 1), (2.0, 1)) == -math.inf


def test_objects_close_together_count_as_one_position() -> None:
    assert until((1.0, 3), (2.0, 1), (3.0, 2)) == 1.0
    assert until((2.0, 1), (3.0, 2)) == -math.inf


def test_agreements_with_different_poses_are_not_combined() -> None:
    history = ConfirmationHistory()
    for stamp, object_id in ((1.0, 1), (2.0, 3)):
        history.add(stamp, [object_id])
    history.on_pose_replaced(MAP)
    history.add(3.0, [1])
    history.on_pose_replaced(MAP)
    history.add(4.0, [3])
    history.on_pose_replaced(MAP)

    assert history.confirmed_until == 1.0


def test_object_removed_from_the_map_confirms_nothing() -> None:
    assert until((1.0, 3), (2.0, 9)) == -math.inf
