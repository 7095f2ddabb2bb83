"""Images are paired by their stamps, whatever order they come in and whichever are lost."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn import SECOND
from cairn.components.object_recognizer.cameras import PATIENCE_NS, Pair, StereoSynchronizer
from cairn.schemas.sensor_msgs import Image

pytestmark = pytest.mark.images


PERIOD = SECOND // 5


def image(frame: int) -> Image:
    return Image(width=frame)


def taken(pairing: StereoSynchronizer, side: str, frame: int, now_ns: int) -> Pair | None:
    if side == "left":
        return pairing.take_left(frame * PERIOD, image(frame), now_ns)
    return pairing.take_right(frame * PERIOD, image(frame))


@given(
    lost=st.sets(st.tuples(st.integers(1, 40), st.sampled_from(["left", "right"]))),
    late=st.sets(st.integers(1, 40)),
)
def test_only_images_of_one_time_are_paired_and_never_an_older_one(
    lost: set[tuple[int, str]], late: set[int]
) -> None:
    pairing = StereoSynchronizer(stereo=True)
    before = 0
    for frame in range(1, 41):
        sides = ("right", "left") if frame in late else ("left", "right")
        for side in sides:
            if (frame, side) in lost:
                continue
            pair = taken(pairing, side, frame, frame * PERIOD)
            if pair is None:
                continue
            assert pair.stamp_ns > before
            before = pair.stamp_ns
            assert pair.left.width * PERIOD == pair.stamp_ns
            assert pair.right is None or pair.right.width == pair.left.width
        if not {(k, side) for k in range(max(1, frame - 6), frame + 1) for side in sides} & lost:
            assert before == frame * PERIOD


def test_without_right_images_left_ones_are_taken_alone_until_they_come_again() -> None:
    pairing = StereoSynchronizer(stereo=True)
    alone = [taken(pairing, "left", k, k * PERIOD) for k in range(1, 20)]

    waited = PATIENCE_NS // PERIOD
    assert [pair is None for pair in alone[: waited + 1]] == [True] * (waited + 1)
    assert all(pair is not None and pair.right is None for pair in alone[waited + 1 :])

    assert taken(pairing, "right", 19, 19 * PERIOD) is None  # too late, but it works again
    assert taken(pairing, "left", 20, 20 * PERIOD) is None
    pair = taken(pairing, "right", 20, 20 * PERIOD)
    assert pair is not None
    assert pair.right is not None


def test_a_pause_of_both_cameras_is_no_loss_of_the_right_one() -> None:
    pairing = StereoSynchronizer(stereo=True)
    taken(pairing, "left", 1, PERIOD)
    assert taken(pairing, "right", 1, PERIOD) is not None

    assert taken(pairing, "left", 100, 100 * PERIOD) is None
    assert taken(pairing, "right", 100, 100 * PERIOD) is not None


def test_one_camera_alone_waits_for_none() -> None:
    pair = taken(StereoSynchronizer(stereo=False), "left", 1, PERIOD)
    assert pair is not None
    assert pair.right is None
