"""Tests of decoding images to gray, and of the checks for damaged files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image as Picture

from cairn import CairnError
from cairn.schemas.sensor_msgs import Image
from cairn.schemas.std_msgs import Header
from cairn.vision.images import eight_bits, gray_of, read_image, upright_size
from tests.cairn.visual_map.views import texture

pytestmark = pytest.mark.images


GRAY = texture(3, 48, 32)


def message(
    encoding: str, rows: NDArray[Any], width: int = 48, padding: int = 0, big: bool = False
) -> Image:
    """Return an image message with these rows of numbers."""
    if rows.dtype.itemsize == 2:
        rows = rows.astype(">u2" if big else "<u2")
    data = np.ascontiguousarray(rows).view(np.uint8).reshape(rows.shape[0], -1)
    padded = np.pad(data, ((0, 0), (0, padding)), constant_values=77)
    return Image(
        header=Header(frame_id="left_camera_optical_frame"),
        height=padded.shape[0],
        width=width,
        encoding=encoding,
        is_bigendian=int(big),
        step=padded.shape[1],
        data=padded.ravel(),
    )


def colored() -> NDArray[np.uint8]:
    """Return an image (h, w, 3) with different blue, green and red channels."""
    return np.dstack([texture(k, 48, 32) for k in range(3)])


@given(padding=st.integers(0, 9))
def test_padding_of_rows_is_ignored(padding: int) -> None:
    np.testing.assert_array_equal(gray_of(message("mono8", GRAY, padding=padding)), GRAY)


@given(padding=st.integers(0, 9), big=st.booleans(), bits=st.sampled_from([8, 10, 12, 16]))
def test_16_bit_messages_of_both_byte_orders_are_decoded(
    padding: int, big: bool, bits: int
) -> None:
    wide = GRAY.astype(np.uint16) << (bits - 8)

    gray = gray_of(message("mono16", wide, padding=padding, big=big))

    np.testing.assert_array_equal(gray, eight_bits(wide))
    assert np.abs(gray.astype(int) - GRAY).max() <= 1


@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("order", ["bgr", "rgb"])
def test_color_encodings_are_converted_to_gray(order: str, bits: int, alpha: bool) -> None:
    color = colored()
    expected = cv2.cvtColor(color, cv2.COLOR_BGR2GRAY)
    given = color if order == "bgr" else color[..., ::-1]
    if alpha:
        given = np.dstack([given, np.full((32, 48), 255, np.uint8)])
    wide = given if bits == 8 else given.astype(np.uint16) << 8

    name = f"{order}{'a' if alpha else ''}{bits}"
    gray = gray_of(message(name, wide.reshape(32, -1), padding=3))

    assert np.abs(gray.astype(int) - expected).max() <= 1


@pytest.mark.parametrize(
    ("encoding", "first"), [("yuv422", False), ("uyvy", False), ("yuv422_yuy2", True)]
)
def test_luminance_of_yuv_is_used(encoding: str, first: bool) -> None:
    color = np.full_like(GRAY, 128)
    pixels = np.dstack([GRAY, color] if first else [color, GRAY]).reshape(32, -1)

    np.testing.assert_array_equal(gray_of(message(encoding, pixels, padding=4)), GRAY)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("bits", [8, 16])
def test_bayer_mosaic_of_one_color_has_its_gray_level(pattern: str, bits: int) -> None:
    level = {"r": 200, "g": 120, "b": 40}
    cell = np.array([level[letter] for letter in pattern], np.uint16).reshape(2, 2)
    mosaic = np.tile(cell, (16, 24)).astype(np.uint8)
    wide = mosaic if bits == 8 else mosaic.astype(np.uint16) << 8

    gray = gray_of(message(f"bayer_{pattern}{bits}", wide))

    expected = cv2.cvtColor(np.array([[[40, 120, 200]]], np.uint8), cv2.COLOR_BGR2GRAY)[0, 0]
    assert np.abs(gray[4:-4, 4:-4].astype(int) - int(expected)).max() <= 2


def test_dark_16_bit_image_stays_dark_and_hot_pixels_are_ignored() -> None:
    dark = np.random.default_rng(1).integers(0, 4, (100, 100)).astype(np.uint16)
    assert eight_bits(dark).max() < 4

    hot = GRAY.astype(np.uint16) << 4
    hot[3, 3] = 65535
    assert np.abs(eight_bits(hot).astype(int) - GRAY)[4:].max() <= 1


@pytest.mark.parametrize(
    ("image", "message_text"),
    [
        (message("jpeg", GRAY), "encoding = 'jpeg' is not supported"),
        (message("rgb8", GRAY), "step = 48 is too small for 48 pixels of rgb8"),
        (message("mono8", GRAY[:, :2], width=2), "2 x 32 pixels, too few"),
        (Image(encoding="mono8"), "0 x 0 pixels, too few"),
        (
            Image(
                encoding="mono8", width=33_000, height=16, step=33_000, data=np.zeros(528_000, "u1")
            ),
            "too large, 33000 x 16 pixels; .* 25 megapixels and 32767",
        ),
        (Image(encoding="mono8", width=2**31, height=0), "too few"),
    ],
)
def test_invalid_message_is_rejected(image: Image, message_text: str) -> None:
    with pytest.raises(CairnError, match=message_text):
        gray_of(image)


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".pgm"])
def test_gray_files_are_read_unchanged(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    cv2.imwrite(str(path), GRAY)

    assert np.abs(read_image(path).astype(int) - GRAY).max() <= 1


def test_color_palette_and_16_bit_files_are_read(tmp_path: Path) -> None:
    color = colored()
    gray = cv2.cvtColor(color, cv2.COLOR_BGR2GRAY).astype(int)
    cv2.imwrite(str(tmp_path / "color.png"), color)
    cv2.imwrite(str(tmp_path / "color16.png"), color.astype(np.uint16) << 4)
    cv2.imwrite(str(tmp_path / "gray16.png"), GRAY.astype(np.uint16) << 4)
    Picture.fromarray(GRAY).convert("P").save(tmp_path / "palette.png")

    assert np.abs(read_image(tmp_path / "color.png") - gray).max() <= 1
    assert np.abs(read_image(tmp_path / "color16.png") - gray).max() <= 1
    assert np.abs(read_image(tmp_path / "gray16.png").astype(int) - GRAY).max() <= 1
    assert np.abs(read_image(tmp_path / "palette.png").astype(int) - GRAY).max() <= 1


def test_transparent_pixels_become_white(tmp_path: Path) -> None:
    half = np.full((32, 48), 255, np.uint8)
    half[:, :24] = 0
    cv2.imwrite(str(tmp_path / "a.png"), np.dstack([colored(), half]))

    read = read_image(tmp_path / "a.png")

    assert (read[:, :24] == 255).all()
    expected = cv2.cvtColor(colored(), cv2.COLOR_BGR2GRAY)[:, 24:]
    assert np.abs(read[:, 24:].astype(int) - expected).max() <= 1


@pytest.mark.parametrize("orientation", range(1, 9))
def test_photographs_are_rotated_upright(tmp_path: Path, orientation: int) -> None:
    undo: Callable[[Any], Any] = {  # the image of a camera in this orientation
        1: lambda a: a,
        2: lambda a: a[:, ::-1],
        3: lambda a: a[::-1, ::-1],
        4: lambda a: a[::-1],
        5: lambda a: a.T,
        6: lambda a: np.rot90(a, 1),
        7: lambda a: a[::-1, ::-1].T,
        8: lambda a: np.rot90(a, -1),
    }[orientation]
    exif = Picture.Exif()
    exif[0x0112] = orientation
    Picture.fromarray(np.ascontiguousarray(undo(GRAY))).save(tmp_path / "a.png", exif=exif)

    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), GRAY)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".pgm"])
def test_truncated_file_is_rejected(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    cv2.imwrite(str(path), texture(1, 320, 240))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])

    with pytest.raises(CairnError, match=rf"a\{suffix}: is truncated"):
        read_image(path)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("how", ["zeros", "noise", "missing", "ended"])
def test_file_damaged_in_the_middle_is_rejected(tmp_path: Path, suffix: str, how: str) -> None:
    path = tmp_path / f"a{suffix}"
    cv2.imwrite(str(path), texture(2, 320, 240))
    data = path.read_bytes()
    middle = len(data) // 2
    part = {
        "zeros": bytes(200),
        "noise": np.random.default_rng(1).bytes(200),
        "missing": b"",
        "ended": b"\xff\xd9" + data[middle + 2 : middle + 200],
    }[how]
    path.write_bytes(data[:middle] + part + data[middle + 200 :])

    with pytest.raises(
        CairnError, match=rf"a\{suffix}: is truncated or damaged .*; give an intact copy"
    ):
        read_image(path)


def jpeg_with_sampling(path: Path, factors: int) -> Path:
    """Write a JPEG file with these sampling factors of its first component (ITU T.81, B.2.2)."""
    Picture.fromarray(GRAY).convert("RGB").save(path)
    data = bytearray(path.read_bytes())
    data[data.index(b"\xff\xc0") + 11] = factors
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("factors", [0x13, 0x31, 0x42])
def test_jpeg_with_unusual_sampling_is_read(tmp_path: Path, factors: int) -> None:
    assert read_image(jpeg_with_sampling(tmp_path / "a.jpg", factors)).shape == GRAY.shape


@pytest.mark.parametrize("factors", [0x00, 0x11, 0x44, 0xFF])
def test_jpeg_with_invalid_sampling_is_rejected(tmp_path: Path, factors: int) -> None:
    with pytest.raises(CairnError, match=r"a\.jpg: is truncated or damaged"):
        read_image(jpeg_with_sampling(tmp_path / "a.jpg", factors))


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("orientation", [1, 3, 6])
def test_upright_size_matches_the_decoded_image(
    tmp_path: Path, suffix: str, orientation: int
) -> None:
    path = tmp_path / f"a{suffix}"
    exif = Picture.Exif()
    exif[0x0112] = orientation
    Picture.fromarray(GRAY[:40]).save(path, exif=exif)

    width, height = upright_size(path)

    assert read_image(path).shape == (height, width)


@pytest.mark.parametrize("mode", ["L", "RGB", "CMYK"])
@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("subsampling", [0, 2])
def test_intact_jpeg_files_of_all_kinds_are_read(
    tmp_path: Path, mode: str, progressive: bool, subsampling: int
) -> None:
    Picture.fromarray(GRAY).convert(mode).save(
        tmp_path / "a.jpg", quality=98, progressive=progressive, subsampling=subsampling
    )

    # Subsampled, CMYK loses detail.
    assert np.median(np.abs(read_image(tmp_path / "a.jpg").astype(int) - GRAY)) <= 6


def test_files_that_are_not_images_are_rejected_by_name(tmp_path: Path) -> None:
    (tmp_path / "empty.png").touch()
    (tmp_path / "text.png").write_text("no image " * 50)
    cv2.imwrite(str(tmp_path / "tiny.png"), GRAY[:3, :3])
    Picture.new("1", (20000, 10000)).save(tmp_path / "huge.png")

    for name, message_text in {
        "missing.png": "No such file",
        "empty.png": "is empty",
        "text.png": "not an image of a known format, .* give a PNG, JPEG, PGM, PPM or BMP file",
        "tiny.png": "has 3 x 3 pixels, too few",
        "huge.png": "is too large",
        ".": "Is a directory",
    }.items():
        with pytest.raises(CairnError, match=message_text) as raised:
            read_image(tmp_path / name)
        assert str(tmp_path) in str(raised.value)
