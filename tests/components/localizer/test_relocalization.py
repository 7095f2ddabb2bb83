"""Relocalization: a lost robot is found again, and until when it was certainly not lost."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cairn.components.localizer import relocalization
from cairn.components.localizer.global_search import GlobalSearchResult
from cairn.components.localizer.observations import Landmark
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.components.localizer.recent_observations import PoseSupport
from cairn.components.localizer.relocalization import (
    BETTER,
    REFUTED,
    ConfirmationHistory,
    Relocalizer,
)
from cairn.schemas.cairn_nav_msgs import ReasonCode

HERE = PoseEstimate((0.0, 0.0, 0.0), np.eye(3) * 1e-4)
POSES = np.array([[5.0, 5.0], [1.0, 1.0], [0.0, 0.0]])


def recent_observations() -> Any:
    """Recent observations that do not confirm or refute the estimated pose."""
    return SimpleNamespace(
        now=(0.0, 0.0, 0.0),
        scanned=True,
        fit=lambda _: 0.2,
        log_likelihood=lambda poses: np.zeros(poses.shape[1]),
    )


def recover_twice(
    monkeypatch: pytest.MonkeyPatch, share: float, score: float, fit: float
) -> list[np.ndarray | None]:
    """Return the poses of two searches that find the robot at (5, 1) with that share."""
    there = PoseEstimate((5.0, 1.0, 0.0), np.eye(3) * 1e-4)
    found = GlobalSearchResult(POSES, there, share, PoseSupport(0, 0), score, fit, POSES)
    monkeypatch.setattr(relocalization, "search", lambda *_: found)
    one = Relocalizer(1000, np.random.default_rng(0))
    return [one.recover(stamp, recent_observations(), HERE) for stamp in (10.0, 11.0)]


def test_unrivaled_better_position_is_accepted_by_the_second_search(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first, second = recover_twice(monkeypatch, share=0.95, score=BETTER + 1.0, fit=0.9)

    assert first is None
    assert second is POSES


def test_ambiguous_search_keeps_a_possible_pose(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert recover_twice(monkeypatch, share=0.5, score=BETTER + 1.0, fit=0.9) == [None, None]


def test_refuted_pose_is_replaced_by_the_most_likely_alternative(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first, second = recover_twice(monkeypatch, share=0.5, score=REFUTED + 1.0, fit=0.9)

    assert first is None
    assert second is POSES


def test_position_that_scans_do_not_fit_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    assert recover_twice(monkeypatch, share=0.5, score=REFUTED + 1.0, fit=0.3) == [None, None]


@dataclass(frozen=True)
class Measurements:
    """Recent measurements of a lost robot, of which the map explains other parts elsewhere."""

    observations: Any
    now: tuple[float, float, float]
    score_there: float = 0.0  # of the scans at (5, 1)
    scanned: bool = True

    def fit(self, _: PoseEstimate) -> float:
        return 0.2

    def log_likelihood(self, poses: np.ndarray) -> np.ndarray:
        is_there = np.abs(poses[0] - 5.0 - self.now[0]) < 0.1
        return np.where(is_there, self.score_there, 0.0)


def searches_against_objects(
    monkeypatch: pytest.MonkeyPatch,
    ahead_m: Sequence[float | None],
    fit: float = 0.9,
    score: float = REFUTED + 1.0,
) -> list[bool]:
    """Return which searches move the robot to (5, 1), where two objects contradict.

    Each is made after the robot has driven so far ahead; None: it finds the robot's pose. `score`
    is that of the scans there; elsewhere it is 0.
    """
    one = Relocalizer(1000, np.random.default_rng(0))
    moved = []
    for stamp, ahead in enumerate(ahead_m):
        there = HERE
        if ahead is not None:
            there = PoseEstimate((5.0 + ahead, 1.0, 0.0), np.eye(3) * 1e-4)
        modes = np.array([there.mean, (1.0, 5.0, 0.0), (3.0, 2.0, 1.0)]).T
        found = GlobalSearchResult(
            POSES, there, 0.95, PoseSupport(0, 2), REFUTED + 1.0, fit, POSES, modes
        )
        monkeypatch.setattr(relocalization, "search", lambda *_, found=found: found)
        recent: Any = Measurements(None, (ahead or 0.0, 0.0, 0.0), score)
        moved.append(one.recover(10.0 + stamp, recent, HERE) is not None)
    return moved


def test_objects_are_outweighed_by_scans_from_three_viewpoints(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert searches_against_objects(monkeypatch, [0.0, 0.1, 0.3, 0.4, 0.6]) == [*[False] * 4, True]


def test_search_that_finds_the_present_pose_ends_the_series(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert not any(searches_against_objects(monkeypatch, [0.0, 0.3, None, 0.6, 0.9]))


DRIVING = (0.0, 0.3, 0.6, 0.9)


@pytest.mark.parametrize(
    ("ahead_m", "fit", "score"),
    [((0.0,) * 6, 0.9, 30.0), (DRIVING, 0.7, 30.0), (DRIVING, 0.9, 2.0)],
    ids=["from one pose", "scans fit badly", "scans are ambiguous"],
)
def test_objects_outweigh_weaker_scans(
    monkeypatch: pytest.MonkeyPatch, ahead_m: Sequence[float], fit: float, score: float
) -> None:
    assert not any(searches_against_objects(monkeypatch, ahead_m, fit, score))


def test_kidnapped_robot_stays_in_doubt_while_scans_fit_badly() -> None:
    relocalizer = Relocalizer(1000, np.random.default_rng(0))
    for _ in range(300):
        relocalizer.update_fit(0.95)
    usual = relocalizer.doubt(30.0)

    for _ in range(100):
        relocalizer.update_fit(0.55)
    doubt = relocalizer.doubt(40.0)

    assert usual is None
    assert doubt is not None
    assert doubt.code == ReasonCode.SCAN_MISMATCH


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
