"""Relocalization: a lost robot is found again, and until when it was certainly not lost."""

import math
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


def evidence() -> Any:
    """Recent observations are as likely as not from the estimated pose."""
    return SimpleNamespace(
        now=(0.0, 0.0, 0.0),
        scanned=True,
        fit=lambda _: 0.2,
        log_likelihood=lambda poses: np.zeros(poses.shape[1]),
    )


def looks(
    monkeypatch: pytest.MonkeyPatch, share: float, score: float, fit: float
) -> list[np.ndarray | None]:
    """Two looks, which find the robot at (5, 1) with that share of the posterior."""
    there = PoseEstimate((5.0, 1.0, 0.0), np.eye(3) * 1e-4)
    found = GlobalSearchResult(POSES, there, share, PoseSupport(0, 0), score, fit, POSES)
    monkeypatch.setattr(relocalization, "search", lambda *_: found)
    one = Relocalizer(1000, np.random.default_rng(0))
    return [one.recover(stamp, evidence(), HERE) for stamp in (10.0, 11.0)]


def test_unrivaled_better_position_is_accepted_by_the_second_search(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first, second = looks(monkeypatch, share=0.95, score=BETTER + 1.0, fit=0.9)

    assert first is None
    assert second is POSES


def test_places_that_look_alike_leave_the_robot_where_it_may_be(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert looks(monkeypatch, share=0.5, score=BETTER + 1.0, fit=0.9) == [None, None]


def test_refuted_robot_moves_to_the_likeliest_lookalike(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first, second = looks(monkeypatch, share=0.5, score=REFUTED + 1.0, fit=0.9)

    assert first is None
    assert second is POSES


def test_position_that_scans_do_not_fit_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    assert looks(monkeypatch, share=0.5, score=REFUTED + 1.0, fit=0.3) == [None, None]


def test_carried_robot_does_not_get_used_to_scans_that_fit_badly() -> None:
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


HERE_AGREEMENTS, BESIDE, FAR = Landmark(1, 0.0, 0.0), Landmark(2, 0.4, 0.0), Landmark(3, 4.0, 0.0)
MAP = {mark.object_id: mark for mark in (HERE_AGREEMENTS, BESIDE, FAR)}


def until(*agreed: tuple[float, int]) -> float:
    it = ConfirmationHistory()
    for stamp, object_id in agreed:
        it.add(stamp, [object_id])
    it.on_pose_replaced(MAP)
    return it.confirmed_until


def test_confirmed_until_the_earlier_of_two_newest_agreements() -> None:
    assert until((1.0, 3), (2.0, 1), (3.0, 3)) == 2.0


def test_one_agreeing_object_does_not_confirm_the_pose() -> None:
    assert until((1.0, 1), (2.0, 1)) == -math.inf


def test_objects_close_together_count_as_one_position() -> None:
    assert until((1.0, 3), (2.0, 1), (3.0, 2)) == 1.0
    assert until((2.0, 1), (3.0, 2)) == -math.inf


def test_agreements_with_different_poses_are_not_combined() -> None:
    it = ConfirmationHistory()
    for stamp, object_id in ((1.0, 1), (2.0, 3)):
        it.add(stamp, [object_id])
    it.on_pose_replaced(MAP)
    it.add(3.0, [1])
    it.on_pose_replaced(MAP)
    it.add(4.0, [3])
    it.on_pose_replaced(MAP)

    assert it.confirmed_until == 1.0


def test_object_removed_from_the_map_confirms_nothing() -> None:
    assert until((1.0, 3), (2.0, 9)) == -math.inf
