"""Correlative search: the best pose is the one that an exhaustive search finds."""

import math

import numpy as np
import pytest

from cairn.components.slam.correlation import CorrelationMap

TURN = math.radians(1.0)


def room(seed: int) -> np.ndarray:
    """Points on the walls of a room with some boxes."""
    random = np.random.default_rng(seed)
    corners = [((0, 0), (6, 0)), ((6, 0), (6, 4)), ((6, 4), (0, 4)), ((0, 4), (0, 0))]
    for x, y in random.uniform(0.5, 3.0, (4, 2)).tolist():
        corners += [((x, y), (x + 0.7, y)), ((x + 0.7, y), (x + 0.7, y + 0.4))]
    share = np.linspace(0.0, 1.0, 60)[:, None]
    return np.concatenate([np.array(a) + share * (np.array(b) - np.array(a)) for a, b in corners])


def moved(points: np.ndarray, x: float, y: float, turn: float) -> np.ndarray:
    """The points in a frame at that pose."""
    cosine, sine = math.cos(turn), math.sin(turn)
    result: np.ndarray = (points - (x, y)) @ np.array([[cosine, -sine], [sine, cosine]])
    return result


@pytest.mark.parametrize("seed", range(5))
def test_the_best_peak_is_that_of_an_exhaustive_search(seed: int) -> None:
    random = np.random.default_rng(seed)
    points = room(seed)
    x, y, turn = random.uniform(-0.6, 0.6), random.uniform(-0.6, 0.6), random.uniform(-0.1, 0.1)
    query = moved(points, x, y, turn)[::7]
    grid = CorrelationMap(points)
    (peak,) = grid.search(query, (0.0, 0.0, 0.0), 0.8, 0.15, 0.1)
    best = 0.0
    for theta in TURN * np.arange(-9, 10):
        for column in range(-8, 9):
            for row in range(-8, 9):
                center = (0.1 * column, 0.1 * row, float(theta))
                found = grid.search(query, center, 0.01, 0.0, 0.0, most=1)
                # A window of one heading and nine cells, of which the best counts.
                best = max(best, max((one.score for one in found), default=0.0))
    assert peak.score >= 0.99 * best - 0.02
    assert math.hypot(peak.pose[0] - x, peak.pose[1] - y) < 0.12
    assert abs(peak.pose[2] - turn) < 0.03


def test_equal_places_are_separate_peaks() -> None:
    points = room(1)
    twice = np.concatenate((points, points + np.array([20.0, 0.0])))
    peaks = CorrelationMap(twice).search(points[::5], (10.0, 0.0, 0.0), 12.0, 0.05, 0.5, 5)
    assert sorted(round(peak.pose[0]) for peak in peaks) == [0, 20]


def test_nothing_is_found_where_nothing_fits() -> None:
    points = room(2)
    assert CorrelationMap(points).search(points, (50.0, 0.0, 0.0), 1.0, 0.1, 0.3) == []
