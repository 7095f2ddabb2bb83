"""Tests of ranging: positions are accurate, and their covariance is honest."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from cairn.vision.ranging import (
    CameraPosition,
    consistent,
    fuse,
    range_by_size,
    range_by_stereo,
)
from cairn.vision.stereo import StereoRig

pytestmark = pytest.mark.images


Array = NDArray[np.float64]

RIG = StereoRig(500.0, 500.0, 319.5, 239.5, 0.12, 640, 480)
# 99.73 % quantile of chi-square with 3 degrees of freedom: 3 sigma of a normal distribution.
WITHIN = 14.16


@dataclass(frozen=True)
class Scene:
    """A picture on a wall, as a stereo camera measures it."""

    truth: Array
    view: tuple[int, int]
    size: tuple[float, float]
    view_points: Array
    image_points: Array
    disparities: Array
    middle: Array

    def range_by_stereo(self) -> CameraPosition | None:
        return range_by_stereo(self.image_points, self.disparities, self.middle, RIG)

    def range_by_size(self) -> CameraPosition | None:
        return range_by_size(self.view_points, self.image_points, self.view, self.size, RIG)


def scene(seed: int, count: int, noise: float, wrong: float = 0.0) -> Scene:
    """Make a scene with `noise` [px] of disparities and a share `wrong` of random matches."""
    random = np.random.default_rng(seed)
    width, height = random.uniform(0.15, 0.6, 2)
    view = (round(1000 * width), round(1000 * height))
    depth = random.uniform(0.8, 4.0)
    truth = np.array([random.uniform(-0.4, 0.4), random.uniform(-0.3, 0.3), 1.0]) * depth
    rotation = cv2.Rodrigues(random.uniform((-0.5, -0.9, -0.3), (0.5, 0.9, 0.3)))[0]
    view_points = random.uniform(0, 1, (count, 2)) * (np.array(view) - 1)
    flat = (view_points - (np.array(view) - 1) / 2) * (width / view[0], height / view[1])
    points = np.column_stack((flat, np.zeros(count))) @ rotation.T + truth
    image_points = points[:, :2] / points[:, 2:] * 500.0 + (319.5, 239.5)
    image_points += random.normal(0, 0.7, image_points.shape)
    disparities = 60.0 / points[:, 2] + random.normal(0, noise, count)
    outliers = random.permutation(count)[: int(wrong * count)]
    disparities[outliers] += random.uniform(-20, 20, outliers.size)
    image_points[outliers] += random.uniform(-40, 40, (outliers.size, 2))
    disparities[random.permutation(count)[: count // 10]] = np.nan
    middle = truth[:2] / truth[2] * 500.0 + (319.5, 239.5) + random.normal(0, 0.3, 2)
    stated = random.normal(1, 0.02)
    return Scene(
        truth, view, (width * stated, height * stated), view_points, image_points, disparities,
        middle,
    )  # fmt: skip


def distance(found: CameraPosition, truth: Array) -> float:
    error = found.position - truth
    return float(error @ np.linalg.solve(found.covariance, error))


@pytest.mark.parametrize("noise", [0.1, 0.4])
@pytest.mark.parametrize(("count", "wrong"), [(20, 0.0), (80, 0.0), (40, 0.3)])
@pytest.mark.parametrize("method", [Scene.range_by_stereo, Scene.range_by_size])
def test_truth_is_within_three_sigma(
    method: Callable[[Scene], CameraPosition | None], count: int, wrong: float, noise: float
) -> None:
    scenes = [scene(seed, count, noise, wrong) for seed in range(60)]
    found = [method(one) for one in scenes]

    distances = [distance(f, s.truth) for f, s in zip(found, scenes, strict=True) if f is not None]

    assert len(distances) >= 0.95 * len(scenes)
    assert np.mean(np.array(distances) > WITHIN) <= 0.02
    # The covariance must not be uselessly large either.
    assert np.mean(distances) > 0.3


def test_stereo_range_is_never_more_certain_than_the_calibration() -> None:
    for seed in range(20):
        found = scene(seed, 40, 0.05).range_by_stereo()
        assert found is not None

        # Baseline and focal length are known to 1 %.
        assert np.sqrt(found.covariance[2, 2]) >= 0.01 * found.position[2]


def test_range_is_accurate_with_a_third_of_wrong_matches() -> None:
    errors = []
    for seed in range(40):
        one = scene(seed, 40, 0.2, wrong=0.3)
        stereo = one.range_by_stereo()
        assert stereo is not None
        errors.append(abs(stereo.position[2] / one.truth[2] - 1))

    assert np.median(errors) < 0.005
    assert np.max(errors) < 0.05


def test_fused_position_is_better_than_each_and_consistent() -> None:
    agreeing = 0
    for seed in range(40):
        one = scene(seed, 40, 0.2)
        stereo, size = one.range_by_stereo(), one.range_by_size()
        assert stereo is not None
        assert size is not None
        both = fuse(stereo, size)
        assert np.trace(both.covariance) <= np.trace(stereo.covariance)
        assert np.trace(both.covariance) <= np.trace(size.covariance)
        assert np.linalg.eigvalsh(both.covariance).min() > 0
        assert distance(both, one.truth) < WITHIN
        agreeing += consistent(stereo, size)

    assert agreeing == 40


@pytest.mark.parametrize(
    "falsify",
    [
        lambda one: replace(one, size=(one.size[0] * 1.5, one.size[1] * 1.5)),
        lambda one: replace(one, disparities=one.disparities * 0.7),
    ],
    ids=["size stated too large", "baseline stated too short"],
)
def test_wrong_size_or_baseline_is_inconsistent(falsify: Callable[[Scene], Scene]) -> None:
    one = falsify(scene(5, 60, 0.1))

    stereo, size = one.range_by_stereo(), one.range_by_size()

    assert stereo is not None
    assert size is not None
    assert not consistent(stereo, size)


def test_stereo_gives_no_range_for_inconsistent_or_distant_matches() -> None:
    one = scene(1, 40, 0.1)
    random = np.random.default_rng(1)

    assert replace(one, disparities=random.uniform(0, 60, 40)).range_by_stereo() is None
    assert replace(one, disparities=np.full(40, np.nan)).range_by_stereo() is None
    assert replace(one, disparities=random.normal(0.3, 0.1, 40)).range_by_stereo() is None
    assert replace(one, disparities=random.normal(-20, 0.1, 40)).range_by_stereo() is None
    assert range_by_stereo(one.image_points[:5], one.disparities[:5], one.middle, RIG) is None


def test_size_gives_no_range_for_few_or_inconsistent_points() -> None:
    one = scene(1, 40, 0.1)
    random = np.random.default_rng(1)
    on_a_line = one.view_points * (1.0, 0.0)

    assert replace(one, image_points=random.uniform(0, 480, (40, 2))).range_by_size() is None
    assert replace(one, view_points=on_a_line).range_by_size() is None
    few = replace(one, view_points=one.view_points[:4], image_points=one.image_points[:4])
    assert few.range_by_size() is None


def test_ranging_is_deterministic() -> None:
    one = scene(7, 40, 0.3, wrong=0.3)
    first, again = one.range_by_stereo(), one.range_by_stereo()

    assert first is not None
    assert again is not None
    assert np.array_equal(first.position, again.position)
    assert np.array_equal(first.covariance, again.covariance)
