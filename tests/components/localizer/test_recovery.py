"""When a robot that is believed to be somewhere is moved elsewhere."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cairn.components.localizer import relocalization
from cairn.components.localizer.global_search import GlobalSearchResult
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.components.localizer.recent_observations import PoseSupport
from cairn.components.localizer.relocalization import BETTER, REFUTED, Relocalizer

HERE = PoseEstimate((0.0, 0.0, 0.0), np.eye(3) * 1e-4)
POSES = np.array([[5.0, 5.0], [1.0, 1.0], [0.0, 0.0]])


def evidence() -> Any:
    """What was seen of late is as likely as not from where the robot is believed to be."""
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


def test_a_place_that_explains_more_and_has_no_rival_is_believed_at_the_second_look(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first, second = looks(monkeypatch, share=0.95, score=BETTER + 1.0, fit=0.9)

    assert first is None
    assert second is POSES


def test_places_that_look_alike_leave_the_robot_where_it_may_be(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert looks(monkeypatch, share=0.5, score=BETTER + 1.0, fit=0.9) == [None, None]


def test_who_is_certainly_not_here_looks_on_from_the_likeliest_of_places_that_look_alike(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first, second = looks(monkeypatch, share=0.5, score=REFUTED + 1.0, fit=0.9)

    assert first is None
    assert second is POSES


def test_a_place_that_scans_do_not_fit_either_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    assert looks(monkeypatch, share=0.5, score=REFUTED + 1.0, fit=0.3) == [None, None]
