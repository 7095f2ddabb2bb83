"""Gray levels are those that the camera sent; what is no whole picture is refused."""

import tracemalloc

import numpy as np
import pytest
import simplejpeg
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cairn.components.v4l2_camera.pixels import (
    DamagedPicture,
    PictureLayout,
    ShortPicture,
    halves,
)

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
def test_gray_rows_are_taken_without_what_fills_them_up(
    width: int, height: int, filling: int, more: int
) -> None:
    sent = noise(width, height)
    rows = np.hstack((sent, np.full((height, filling), 7, np.uint8)))

    taken = PictureLayout(width, height, "GREY", width + filling).gray(rows.tobytes() + bytes(more))

    assert taken.tolist() == sent.tolist()


@pytest.mark.parametrize("half", [1, 7, 32])
@pytest.mark.parametrize("height", [1, 5])
@pytest.mark.parametrize("filling", [0, 1, 9])
def test_of_yuyv_the_brightness_is_taken(half: int, height: int, filling: int) -> None:
    sent = noise(2 * half, height)
    both = np.dstack((sent, np.full_like(sent, 128))).reshape(height, -1)
    rows = np.hstack((both, np.full((height, filling), 7, np.uint8)))

    layout = PictureLayout(2 * half, height, "YUYV", 4 * half + filling)

    assert layout.gray(rows.tobytes()).tolist() == sent.tolist()


@pytest.mark.parametrize(("name", "pixel"), [("GREY", 1), ("YUYV", 2)])
def test_a_picture_of_too_few_bytes_is_refused(name: str, pixel: int) -> None:
    layout = PictureLayout(WIDTH, HEIGHT, name)
    whole = bytes(WIDTH * HEIGHT * pixel)

    assert layout.gray(whole).shape == (HEIGHT, WIDTH)
    with pytest.raises(ShortPicture, match=f"{len(whole) - 1} bytes of {len(whole)}"):
        layout.gray(whole[:-1])


@pytest.mark.parametrize("sampling", ["444", "422", "420"])
def test_mjpg_is_decoded_to_its_brightness(sampling: str) -> None:
    data = jpeg(sampling)

    taken = PictureLayout(WIDTH, HEIGHT, "MJPG").gray(data)

    assert taken.tolist() == simplejpeg.decode_jpeg(data, colorspace="GRAY")[..., 0].tolist()


def test_mjpg_without_its_tables_is_decoded_by_the_usual_ones() -> None:
    whole = PictureLayout(WIDTH, HEIGHT, "MJPG").gray(jpeg())

    taken = PictureLayout(WIDTH, HEIGHT, "MJPG").gray(without_tables(jpeg()))

    assert taken.tolist() == whole.tolist()


@pytest.mark.parametrize("behind", [b"\0" * 100, b"left of a former picture", b"\xff"])
def test_what_follows_the_end_of_mjpg_is_no_part_of_it(behind: bytes) -> None:
    layout = PictureLayout(WIDTH, HEIGHT, "MJPG")

    assert layout.gray(jpeg() + behind).tolist() == layout.gray(jpeg()).tolist()


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (jpeg()[: len(jpeg()) // 2], "no end"),
        (jpeg()[: len(jpeg()) // 2] + b"\xff\xd9", "premature end"),
        (b"\0\0" + jpeg()[2:], "begins with 0000"),
        (b"", "begins with nothing"),
        (b"\xff\xd8\xff\xd9", "JPEG image"),
    ],
)
def test_damaged_mjpg_is_refused(data: bytes, what: str) -> None:
    with pytest.raises((ShortPicture, DamagedPicture), match=what):
        PictureLayout(WIDTH, HEIGHT, "MJPG").gray(data)


def test_mjpg_of_another_size_is_refused() -> None:
    with pytest.raises(DamagedPicture, match="it is 64 x 48 pixels, not 32 x 48"):
        PictureLayout(32, HEIGHT, "MJPG").gray(jpeg())


def test_memory_is_not_taken_for_a_size_that_damage_has_made() -> None:
    size = HEIGHT.to_bytes(2, "big") + WIDTH.to_bytes(2, "big")
    assert jpeg().count(size) == 1

    tracemalloc.start()
    with pytest.raises(DamagedPicture, match="it is 9999 x 9999 pixels, not 64 x 48"):
        PictureLayout(WIDTH, HEIGHT, "MJPG").gray(jpeg().replace(size, b"\x27\x0f" * 2))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()

    assert most < 1_000_000


@settings(deadline=None, max_examples=30, suppress_health_check=[HealthCheck.too_slow])
@given(st.integers(0, len(jpeg()) - 1), st.binary(min_size=1, max_size=50))
def test_overwritten_mjpg_gives_a_picture_or_is_refused(place: int, over: bytes) -> None:
    data = jpeg()
    data = data[:place] + over + data[place + len(over) :]
    layout = PictureLayout(WIDTH, HEIGHT, "MJPG")

    try:
        taken = layout.gray(data)
    except (ShortPicture, DamagedPicture):
        return
    assert taken.shape == (HEIGHT, WIDTH)


def test_a_side_by_side_picture_is_parted() -> None:
    sent = noise()

    left, right = halves(sent)

    assert np.hstack((left, right)).tolist() == sent.tolist()
    assert left.shape == right.shape
    assert left.flags.c_contiguous
    assert right.flags.c_contiguous


def without_tables(data: bytes) -> bytes:
    """A JPEG picture without its Huffman tables, as many cameras send it."""
    kept, place = data[:2], 2
    while data[place + 1] != 0xDA:  # SOS, behind which the picture is
        end = place + 2 + int.from_bytes(data[place + 2 : place + 4], "big")
        if data[place + 1] != 0xC4:  # DHT
            kept += data[place:end]
        place = end
    return kept + data[place:]
