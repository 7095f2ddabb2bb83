"""A flat object is found where it is, as often within the stated error as it should be."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from cairn.vision.ranging import Located, by_size, by_stereo, fused
from cairn.vision.stereo import StereoRig

pytestmark = pytest.mark.images


Array = NDArray[np.float64]

RIG = StereoRig(500.0, 500.0, 319.5, 239.5, 0.12, 640, 480)
# 99.73 % of a normal distribution in space lie within 3 sigma in this sense (chi-square, 3 degrees
# of freedom).
WITHIN = 14.16


@dataclass(frozen=True)
class Scene:
    """A picture on a wall as a stereo camera measures it."""

    truth: Array
    view: tuple[int, int]
    size: tuple[float, float]
    view_points: Array
    image_points: Array
    disparities: Array
    middle: Array

    def by_stereo(self) -> Located | None:
        return by_stereo(self.image_points, self.disparities, self.middle, RIG)

    def by_size(self) -> Located | None:
        return by_size(self.view_points, self.image_points, self.view, self.size, RIG)


def scene(seed: int, count: int, noise: float, wrong: float = 0.0) -> Scene:
    """`noise` [px] of disparities, `wrong` the share of matches that are anywhere."""
    random = np.random.default_rng(seed)
    width, height = random.uniform(0.15, 0.6, 2)
    view = (round(1000 * width), round(1000 * height))
    depth = random.uniform(0.8, 4.0)
    truth = np.array([random.uniform(-0.4, 0.4), random.uniform(-0.3, 0.3), 1.0]) * depth
    turn = cv2.Rodrigues(random.uniform((-0.5, -0.9, -0.3), (0.5, 0.9, 0.3)))[0]
    view_points = random.uniform(0, 1, (count, 2)) * (np.array(view) - 1)
    flat = (view_points - (np.array(view) - 1) / 2) * (width / view[0], height / view[1])
    points = np.column_stack((flat, np.zeros(count))) @ turn.T + truth
    image_points = points[:, :2] / points[:, 2:] * 500.0 + (319.5, 239.5)
    image_points += random.normal(0, 0.7, image_points.shape)
    disparities = 60.0 / points[:, 2] + random.normal(0, noise, count)
    astray = random.permutation(count)[: int(wrong * count)]
    disparities[astray] += random.uniform(-20, 20, astray.size)
    image_points[astray] += random.uniform(-40, 40, (astray.size, 2))
    disparities[random.permutation(count)[: count // 10]] = np.nan
    middle = truth[:2] / truth[2] * 500.0 + (319.5, 239.5) + random.normal(0, 0.3, 2)
    stated = random.normal(1, 0.02)
    return Scene(
        truth, view, (width * stated, height * stated), view_points, image_points, disparities,
        middle,
    )  # fmt: skip


def distance(found: Located, truth: Array) -> float:
    error = found.position - truth
    return float(error @ np.linalg.solve(found.covariance, error))


@pytest.mark.parametrize("noise", [0.1, 0.4])
@pytest.mark.parametrize(("count", "wrong"), [(20, 0.0), (80, 0.0), (40, 0.3)])
@pytest.mark.parametrize("way", [Scene.by_stereo, Scene.by_size])
def test_truth_lies_within_three_sigma(
    way: Callable[[Scene], Located | None], count: int, wrong: float, noise: float
) -> None:
    scenes = [scene(seed, count, noise, wrong) for seed in range(60)]
    found = [way(one) for one in scenes]

    distances = [distance(f, s.truth) for f, s in zip(found, scenes, strict=True) if f is not None]

    assert len(distances) >= 0.95 * len(scenes)
    assert np.mean(np.array(distances) > WITHIN) <= 0.02
    # Nor is the error stated so large that it says nothing.
    assert np.mean(distances) > 0.3


def test_with_a_third_of_matches_wrong_range_is_still_right() -> None:
    errors = []
    for seed in range(40):
        one = scene(seed, 40, 0.2, wrong=0.3)
        stereo = one.by_stereo()
        assert stereo is not None
        errors.append(abs(stereo.position[2] / one.truth[2] - 1))

    assert np.median(errors) < 0.005
    assert np.max(errors) < 0.05


def test_both_ways_together_are_better_than_each_and_are_told_to_agree() -> None:
    agreeing = 0
    for seed in range(40):
        one = scene(seed, 40, 0.2)
        stereo, size = one.by_stereo(), one.by_size()
        assert stereo is not None
        assert size is not None
        both = fused(stereo, size)
        assert both is not None
        assert np.trace(both.located.covariance) <= np.trace(stereo.covariance)
        assert np.trace(both.located.covariance) <= np.trace(size.covariance)
        assert np.linalg.eigvalsh(both.located.covariance).min() > 0
        assert distance(both.located, one.truth) < WITHIN
        agreeing += both.consistent

    assert agreeing == 40


@pytest.mark.parametrize(
    "lie",
    [
        lambda one: replace(one, size=(one.size[0] * 1.5, one.size[1] * 1.5)),
        lambda one: replace(one, disparities=one.disparities * 0.7),
    ],
    ids=["stated half as large again", "cameras not where they are said to be"],
)
def test_a_wrong_size_or_a_wrong_baseline_is_told(lie: Callable[[Scene], Scene]) -> None:
    one = lie(scene(5, 60, 0.1))

    both = fused(one.by_stereo(), one.by_size())

    assert both is not None
    assert both.distance is not None
    assert not both.consistent


def test_one_way_is_enough_and_none_is_none() -> None:
    size = scene(1, 40, 0.1).by_size()
    assert size is not None

    alone = fused(None, size)

    assert alone is not None
    assert (alone.located, alone.distance, alone.consistent) == (size, None, True)
    assert fused(None, None) is None


def test_there_is_no_range_by_stereo_where_the_matches_do_not_agree_or_it_is_far() -> None:
    one = scene(1, 40, 0.1)
    random = np.random.default_rng(1)

    assert replace(one, disparities=random.uniform(0, 60, 40)).by_stereo() is None
    assert replace(one, disparities=np.full(40, np.nan)).by_stereo() is None
    assert replace(one, disparities=random.normal(0.3, 0.1, 40)).by_stereo() is None
    assert replace(one, disparities=random.normal(-20, 0.1, 40)).by_stereo() is None
    assert by_stereo(one.image_points[:5], one.disparities[:5], one.middle, RIG) is None


def test_there_is_no_range_by_size_from_few_or_disordered_points() -> None:
    one = scene(1, 40, 0.1)
    random = np.random.default_rng(1)
    on_a_line = one.view_points * (1.0, 0.0)

    assert replace(one, image_points=random.uniform(0, 480, (40, 2))).by_size() is None
    assert replace(one, view_points=on_a_line).by_size() is None
    few = replace(one, view_points=one.view_points[:4], image_points=one.image_points[:4])
    assert few.by_size() is None


def test_the_same_measurements_give_the_same_place() -> None:
    one = scene(7, 40, 0.3, wrong=0.3)
    first, again = one.by_stereo(), one.by_stereo()

    assert first is not None
    assert again is not None
    assert np.array_equal(first.position, again.position)
    assert np.array_equal(first.covariance, again.covariance)
