"""Tests of the synchronization of left and right images."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn import SECOND
from cairn.components.object_recognizer.cameras import PATIENCE_NS, StereoImages, StereoSynchronizer
from cairn.schemas.sensor_msgs import Image

pytestmark = pytest.mark.images


PERIOD = SECOND // 5


def image(frame: int) -> Image:
    return Image(width=frame)


def add(
    synchronizer: StereoSynchronizer, side: str, frame: int, now_ns: int
) -> StereoImages | None:
    if side == "left":
        return synchronizer.add_left(frame * PERIOD, image(frame), now_ns)
    return synchronizer.add_right(frame * PERIOD, image(frame))


@given(
    lost=st.sets(st.tuples(st.integers(1, 40), st.sampled_from(["left", "right"]))),
    late=st.sets(st.integers(1, 40)),
)
def test_pairs_have_equal_stamps_and_never_go_back(
    lost: set[tuple[int, str]], late: set[int]
) -> None:
    synchronizer = StereoSynchronizer(stereo=True)
    before = 0
    for frame in range(1, 41):
        sides = ("right", "left") if frame in late else ("left", "right")
        for side in sides:
            if (frame, side) in lost:
                continue
            pair = add(synchronizer, side, frame, frame * PERIOD)
            if pair is None:
                continue
            assert pair.stamp_ns > before
            before = pair.stamp_ns
            assert pair.left.width * PERIOD == pair.stamp_ns
            assert pair.right is None or pair.right.width == pair.left.width
        if not {(k, side) for k in range(max(1, frame - 6), frame + 1) for side in sides} & lost:
            assert before == frame * PERIOD


def test_left_images_are_used_alone_while_right_ones_are_missing() -> None:
    synchronizer = StereoSynchronizer(stereo=True)
    alone = [add(synchronizer, "left", k, k * PERIOD) for k in range(1, 20)]

    waited = PATIENCE_NS // PERIOD
    assert [pair is None for pair in alone[: waited + 1]] == [True] * (waited + 1)
    assert all(pair is not None and pair.right is None for pair in alone[waited + 1 :])

    assert (
        add(synchronizer, "right", 19, 19 * PERIOD) is None
    )  # too late, but right images arrive again
    assert add(synchronizer, "left", 20, 20 * PERIOD) is None
    pair = add(synchronizer, "right", 20, 20 * PERIOD)
    assert pair is not None
    assert pair.right is not None


def test_pause_of_both_cameras_is_not_a_missing_right_camera() -> None:
    synchronizer = StereoSynchronizer(stereo=True)
    add(synchronizer, "left", 1, PERIOD)
    assert add(synchronizer, "right", 1, PERIOD) is not None

    assert add(synchronizer, "left", 100, 100 * PERIOD) is None
    assert add(synchronizer, "right", 100, 100 * PERIOD) is not None


def test_single_camera_does_not_wait() -> None:
    pair = add(StereoSynchronizer(stereo=False), "left", 1, PERIOD)
    assert pair is not None
    assert pair.right is None
