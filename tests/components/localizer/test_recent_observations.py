"""Recent observations: which poses they support, at any heading."""

import math
import tracemalloc

import numpy as np
import pytest

from cairn.components.localizer.observations import Landmark
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.components.localizer.recent_observations import PoseSupport, RecentObservations
from cairn.planar.poses import wrap
from cairn.visual_map.observations import Observation

LANDMARKS = {
    number: Landmark(number, 2.0 * math.cos(angle), 2.0 * math.sin(angle), reliability=0.9)
    for number, angle in enumerate(math.radians(degrees) for degrees in range(15, 360, 45))
}


@pytest.mark.parametrize("heading", [math.radians(degrees) for degrees in range(-180, 180, 30)])
def test_true_pose_is_supported_by_all_objects_around_it(heading: float) -> None:
    here = (0.0, 0.0, heading)
    recent = RecentObservations()
    bearings = {i: wrap(math.atan2(mark.y, mark.x) - heading) for i, mark in LANDMARKS.items()}
    made = [Observation(i, 2.0, bearing, 0.01, 0.0003) for i, bearing in bearings.items()]
    recent.add(made, here, 0.0)

    support = recent.support(PoseEstimate(here, np.eye(3) * 1e-4), here, 0.0, LANDMARKS)

    assert support == PoseSupport(agreeing=len(LANDMARKS), contradicting=0)


def test_confused_objects_do_not_contradict_the_pose_of_a_robot_that_stands_for_long() -> None:
    here = (0.0, 0.0, 0.0)
    recent = RecentObservations()
    random = np.random.default_rng(0)
    contradicting = []
    for _ in range(3000):  # ten minutes
        ids = [0, 1]  # what is there, with one percent of confusions
        ids = [int(random.integers(2, 8)) if random.random() < 0.01 else one for one in ids]
        bearings = (math.radians(15), math.radians(60))
        made = [Observation(i, 2.0, b, 0.01, 0.0003) for i, b in zip(ids, bearings, strict=True)]
        recent.add(made, here, 0.0)
        support = recent.support(PoseEstimate(here, np.eye(3) * 1e-4), here, 0.0, LANDMARKS)
        contradicting.append(support.contradicting)

    assert support.agreeing == 2
    assert np.mean(contradicting) < 0.05


def test_object_that_was_hidden_for_long_counts_again_soon() -> None:
    here = (0.0, 0.0, 0.0)
    recent = RecentObservations()
    both = [Observation(i, 2.0, math.radians(15 + 45 * i), 0.01, 0.0003) for i in (0, 1)]

    def agreeing(images: int, made: list[Observation]) -> int:
        for _ in range(images):
            recent.add(made, here, 0.0)
        pose = PoseEstimate(here, np.eye(3) * 1e-4)
        return recent.support(pose, here, 0.0, LANDMARKS).agreeing

    assert agreeing(100, both) == 2
    assert agreeing(10_000, []) == 2  # in the dark
    assert agreeing(10_000, both[:1]) == 1  # something stands before it
    assert agreeing(30, both) == 2


def test_object_contradicts_the_pose_once_two_images_show_it_elsewhere() -> None:
    here = (0.0, 0.0, 0.0)
    recent = RecentObservations()
    contradicting = []
    for _ in range(2):
        recent.add([Observation(0, 1.0, 0.0, 0.01, 0.0003)], here, 0.0)
        support = recent.support(PoseEstimate(here, np.eye(3) * 1e-4), here, 0.0, LANDMARKS)
        contradicting.append(support.contradicting)

    assert contradicting == [0, 1]


def test_memory_for_the_poses_of_a_global_search_does_not_grow_with_the_observations() -> None:
    recent = RecentObservations()
    for moved_s in range(4):
        made = [Observation(i, 2.0, 0.1 * i, 0.01, 0.0003) for i in LANDMARKS]
        recent.add(made, (0.5 * moved_s, 0.0, 0.0), float(moved_s))
    poses = np.random.default_rng(1).uniform(-2.0, 2.0, (3, 20_000))
    now = (1.5, 0.0, 0.0)
    of_each = [recent.log_likelihood(poses[:, [i]], now, 3.0, LANDMARKS)[0] for i in (0, 12_345)]

    tracemalloc.start()
    likelihood = recent.log_likelihood(poses, now, 3.0, LANDMARKS)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()

    assert peak < 8 << 20, "bytes; 30 MB if all poses are compared at once"
    assert likelihood[[0, 12_345]] == pytest.approx(of_each)
