"""Gray levels are those that the camera sent; incomplete images are rejected."""

import tracemalloc

import numpy as np
import pytest
import simplejpeg
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cairn.components.v4l2_camera.decoding import (
    DamagedImageError,
    ImageLayout,
    ShortImageError,
    split_side_by_side,
)
from tests.wording import words_in_order

WIDTH, HEIGHT = 64, 48


def noise(width: int = WIDTH, height: int = HEIGHT) -> NDArray[np.uint8]:
    return np.random.default_rng(0).integers(0, 256, (height, width), np.uint8)


def jpeg(sampling: str = "422") -> bytes:
    gray = noise()
    colors = np.dstack((gray, gray[::-1], 255 - gray))
    return bytes(
        simplejpeg.encode_jpeg(colors, quality=90, colorspace="RGB", colorsubsampling=sampling)
    )


@pytest.mark.parametrize("width", [1, 7, 64])
@pytest.mark.parametrize("height", [1, 5])
@pytest.mark.parametrize(("filling", "more"), [(0, 0), (1, 0), (9, 100)])
def test_padding_of_gray_rows_is_skipped(width: int, height: int, filling: int, more: int) -> None:
    sent = noise(width, height)
    rows = np.hstack((sent, np.full((height, filling), 7, np.uint8)))

    taken = ImageLayout(width, height, "GREY", width + filling).decode(rows.tobytes() + bytes(more))

    assert taken.tolist() == sent.tolist()


@pytest.mark.parametrize("half", [1, 7, 32])
@pytest.mark.parametrize("height", [1, 5])
@pytest.mark.parametrize("filling", [0, 1, 9])
def test_yuyv_is_decoded_to_its_brightness(half: int, height: int, filling: int) -> None:
    sent = noise(2 * half, height)
    both = np.dstack((sent, np.full_like(sent, 128))).reshape(height, -1)
    rows = np.hstack((both, np.full((height, filling), 7, np.uint8)))

    layout = ImageLayout(2 * half, height, "YUYV", 4 * half + filling)

    assert layout.decode(rows.tobytes()).tolist() == sent.tolist()


@pytest.mark.parametrize(("name", "pixel"), [("GREY", 1), ("YUYV", 2)])
def test_image_of_too_few_bytes_is_rejected(name: str, pixel: int) -> None:
    layout = ImageLayout(WIDTH, HEIGHT, name)
    whole = bytes(WIDTH * HEIGHT * pixel)

    assert layout.decode(whole).shape == (HEIGHT, WIDTH)
    with pytest.raises(ShortImageError, match=f"{len(whole) - 1} bytes of {len(whole)}"):
        layout.decode(whole[:-1])


@pytest.mark.parametrize("sampling", ["444", "422", "420"])
def test_mjpg_is_decoded_to_its_brightness(sampling: str) -> None:
    data = jpeg(sampling)

    taken = ImageLayout(WIDTH, HEIGHT, "MJPG").decode(data)

    assert taken.tolist() == simplejpeg.decode_jpeg(data, colorspace="GRAY")[..., 0].tolist()


def test_mjpg_without_tables_is_decoded_with_the_standard_ones() -> None:
    whole = ImageLayout(WIDTH, HEIGHT, "MJPG").decode(jpeg())

    taken = ImageLayout(WIDTH, HEIGHT, "MJPG").decode(without_tables(jpeg()))

    assert taken.tolist() == whole.tolist()


@pytest.mark.parametrize("behind", [b"\0" * 100, b"left of a former picture", b"\xff"])
def test_bytes_after_the_end_of_mjpg_are_ignored(behind: bytes) -> None:
    layout = ImageLayout(WIDTH, HEIGHT, "MJPG")

    assert layout.decode(jpeg() + behind).tolist() == layout.decode(jpeg()).tolist()


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (jpeg()[: len(jpeg()) // 2], "no end"),
        (jpeg()[: len(jpeg()) // 2] + b"\xff\xd9", "premature end"),
        (b"\0\0" + jpeg()[2:], "starts with 0000"),
        (b"", "starts with nothing"),
        (b"\xff\xd8\xff\xd9", "JPEG image"),
    ],
)
def test_damaged_mjpg_is_rejected(data: bytes, what: str) -> None:
    with pytest.raises((ShortImageError, DamagedImageError), match=what):
        ImageLayout(WIDTH, HEIGHT, "MJPG").decode(data)


def test_mjpg_of_another_size_is_rejected() -> None:
    with pytest.raises(DamagedImageError, match=words_in_order("64 x 48", "32 x 48")):
        ImageLayout(32, HEIGHT, "MJPG").decode(jpeg())


def test_no_memory_is_allocated_for_a_damaged_size() -> None:
    size = HEIGHT.to_bytes(2, "big") + WIDTH.to_bytes(2, "big")
    assert jpeg().count(size) == 1

    tracemalloc.start()
    with pytest.raises(DamagedImageError, match=words_in_order("9999 x 9999", "64 x 48")):
        ImageLayout(WIDTH, HEIGHT, "MJPG").decode(jpeg().replace(size, b"\x27\x0f" * 2))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()

    assert most < 1_000_000


@settings(deadline=None, max_examples=30, suppress_health_check=[HealthCheck.too_slow])
@given(st.integers(0, len(jpeg()) - 1), st.binary(min_size=1, max_size=50))
def test_overwritten_mjpg_is_decoded_or_rejected(place: int, over: bytes) -> None:
    data = jpeg()
    data = data[:place] + over + data[place + len(over) :]
    layout = ImageLayout(WIDTH, HEIGHT, "MJPG")

    try:
        taken = layout.decode(data)
    except (ShortImageError, DamagedImageError):
        return
    assert taken.shape == (HEIGHT, WIDTH)


def test_side_by_side_image_is_split() -> None:
    sent = noise()

    left, right = split_side_by_side(sent)

    assert np.hstack((left, right)).tolist() == sent.tolist()
    assert left.shape == right.shape
    assert left.flags.c_contiguous
    assert right.flags.c_contiguous


def without_tables(data: bytes) -> bytes:
    """A JPEG image without its Huffman tables, as many cameras send it."""
    kept, place = data[:2], 2
    while data[place + 1] != 0xDA:  # SOS, behind which the picture is
        end = place + 2 + int.from_bytes(data[place + 2 : place + 4], "big")
        if data[place + 1] != 0xC4:  # DHT
            kept += data[place:end]
        place = end
    return kept + data[place:]
