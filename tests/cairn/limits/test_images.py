"""Images of all supported kinds are decoded; hostile images and videos are refused, cheaply."""

import struct
import zlib
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image as Picture

from cairn.errors import CairnError
from cairn.limits.images import IMAGE_PIXELS, decode_image, read_header
from cairn.vision.images import decode
from tests.hostile_files import (
    GRID_MAPS,
    HOSTILE,
    PICTURES,
    TEXTURES,
    VIDEOS,
    exif_bomb,
    expanding_chunks,
    jpeg_with,
    png,
    png_chunk,
    png_with,
)
from tests.hostile_reading import MOST_MEMORY_MB, MOST_SECONDS, READERS, read_all

RANDOM = np.random.default_rng(1)
COLORS: NDArray[np.uint8] = RANDOM.integers(0, 256, (20, 30, 4)).astype(np.uint8)
# Those that would take most memory or time: they are read in a process of limited memory.
_HEAVY = (
    "picture/png_pixels", "picture/png_late_profiles", "texture/zeros", "grid_map/image_pixels",
)  # fmt: skip
_SLOW_TO_BUILD = (
    "picture/png_chunks", "picture/png_parts", "picture/png_rgba16", "picture/jpeg_scans",
    "picture/jpeg_most_scans", "picture/jpeg_segments", "picture/jpeg_fill", "picture/jpeg_exif",
    "picture/pgm_text", "picture/pgm_comment", "texture/pixels",
)  # fmt: skip
_LIGHT = [
    *(f"picture/{name}" for name in PICTURES),
    *(f"texture/{name}" for name in TEXTURES),
    *(f"video/{name}" for name in VIDEOS),
    *(f"grid_map/{name}" for name in GRID_MAPS if name.startswith("image_")),
]


@pytest.mark.parametrize("case", [c for c in _LIGHT if c not in (*_HEAVY, *_SLOW_TO_BUILD)])
def test_hostile_image_is_refused_with_its_reason(tmp_path: Path, case: str) -> None:
    kind, _, name = case.partition("/")
    hostile = HOSTILE[kind][name]
    file = hostile.build(tmp_path)

    with pytest.raises(CairnError, match=hostile.reason) as refusal:
        READERS[kind](file)

    assert str(tmp_path) in str(refusal.value)
    assert ";" in str(refusal.value)  # before the remedy


@pytest.mark.accuracy
@pytest.mark.slow  # a process imports the readers
def test_hostile_images_take_little_time_and_memory() -> None:
    for case, outcome in read_all(_HEAVY).items():
        assert outcome.error == "CairnError", (case, outcome)
        assert outcome.seconds < MOST_SECONDS, (case, outcome)
        assert outcome.peak_mb < MOST_MEMORY_MB, (case, outcome)


def test_optional_parts_of_images_do_not_matter() -> None:
    black = png(64, 64)
    larger = png_chunk(b"IHDR", struct.pack(">IIBBBBB", 30_000, 30_000, 8, 0, 0, 0, 0))

    for image in (png_with(expanding_chunks(600)), png_with(larger), black + bytes(1000)):
        _, pixels = decode_image("it", image)
        assert pixels.shape == (64, 64)
        assert not pixels.any()
    assert decode_image("it", jpeg_with(exif_bomb() * 20))[1].shape == (64, 64)


def test_first_picture_of_an_animation_is_decoded() -> None:
    first, second = (Picture.fromarray(COLORS[..., k]) for k in (0, 1))
    stream = BytesIO()
    first.save(stream, "PNG", save_all=True, append_images=[second])

    assert np.array_equal(decode_image("it", stream.getvalue())[1], COLORS[..., 0])


@pytest.mark.parametrize(
    ("kind", "mode"),
    [
        *(("PNG", mode) for mode in ("1", "L", "LA", "P", "RGB", "RGBA")),
        *(("BMP", mode) for mode in ("1", "L", "P", "RGB")),
    ],
)
def test_pixels_of_all_modes_are_decoded_as_stored(kind: str, mode: str) -> None:
    picture = Picture.fromarray(np.tile(COLORS, (20, 1, 1)))  # several bands
    picture = (picture.convert("RGB") if mode == "P" else picture).convert(mode)
    stream = BytesIO()
    picture.save(stream, kind)
    expected = picture.convert({"1": "L", "P": "RGB"}.get(mode, mode))

    assert np.array_equal(decode_image("it", stream.getvalue())[1], np.asarray(expected))


def test_interlaced_images_are_decoded() -> None:
    passes = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2),
              (0, 1, 1, 2))  # first column and row, steps (PNG 3, 8)  # fmt: skip
    gray = COLORS[..., 0]
    parts = (gray[y::down, x::right] for x, y, right, down in passes)
    rows = b"".join(b"\0" + row.tobytes() for part in parts for row in part)
    header = struct.pack(">IIBBBBB", 30, 20, 8, 0, 0, 0, 1)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))

    data = b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(*chunk) for chunk in chunks)

    assert np.array_equal(decode_image("it", data)[1], gray)


def test_transparency_by_color_is_opacity() -> None:
    stream = BytesIO()
    Picture.fromarray(COLORS[..., 0]).save(stream, "PNG", transparency=int(COLORS[0, 0, 0]))

    pixels = decode_image("it", stream.getvalue())[1]

    assert pixels.shape == (20, 30, 2)
    assert np.array_equal(pixels[..., 1] == 0, COLORS[..., 0] == COLORS[0, 0, 0])


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_16_bits_of_png_images_are_kept(channels: int) -> None:
    wide = (COLORS[..., :channels].astype(np.uint16) << 8) + np.uint16(7)
    data = cv2.imencode(".png", wide)[1].tobytes()  # which takes them as BGR
    order = {1: [0], 3: [2, 1, 0], 4: [2, 1, 0, 3]}[channels]

    assert np.array_equal(decode_image("it", data)[1], wide[..., order].squeeze())


@pytest.mark.parametrize("kind", [2, 3, 5, 6])
@pytest.mark.parametrize("most", [1, 99, 255, 1023, 65535])
def test_all_kinds_of_pgm_and_ppm_are_scaled_to_white(kind: int, most: int) -> None:
    shape = (20, 30) if kind in (2, 5) else (20, 30, 3)
    values = RANDOM.integers(0, most + 1, shape)
    white, words = (255, "u1") if most < 256 else (65535, ">u2")
    body = (
        " ".join(map(str, values.ravel())).encode()
        if kind in (2, 3)
        else values.astype(words).tobytes()
    )

    _, pixels = decode_image("it", b"P%d # by hand\n#\n30\t20\n%d\n" % (kind, most) + body)

    assert np.array_equal(pixels, np.rint(values * white / most))
    assert pixels.dtype.itemsize == np.dtype(words).itemsize


def test_largest_images_are_accepted() -> None:
    side = round(IMAGE_PIXELS**0.5)

    header = read_header("it", BytesIO(png(side, side, complete=False)))

    assert (header.width, header.height) == (side, side)
    with pytest.raises(CairnError, match=f"{side + 1} x {side} pixels; .* 25 megapixels"):
        read_header("it", BytesIO(png(side + 1, side, complete=False)))


def _samples() -> list[bytes]:
    samples = []
    for kind, options in (
        ("PNG", {}), ("BMP", {}), ("PPM", {}), ("JPEG", {}), ("JPEG", {"progressive": True})
    ):  # fmt: skip
        for mode in ("L", "RGB"):
            stream = BytesIO()
            Picture.fromarray(COLORS).convert(mode).save(stream, kind, **options)
            samples.append(stream.getvalue())
    samples.append(cv2.imencode(".png", COLORS.astype(np.uint16) << 4)[1].tobytes())
    samples.append(png_with(expanding_chunks(3)))
    samples.append(jpeg_with(exif_bomb()))
    samples.append(b"P2 4 4 99 " + b"7 " * 16)
    return samples


_SAMPLES = _samples()


@settings(max_examples=100, deadline=None)
@given(
    sample=st.sampled_from(_SAMPLES),
    at=st.integers(0, 2000),
    replaced=st.integers(0, 8),
    data=st.binary(max_size=8),
)
def test_damaged_image_is_decoded_or_refused(
    sample: bytes, at: int, replaced: int, data: bytes
) -> None:
    at %= len(sample)
    with suppress(CairnError):
        gray = decode("it", sample[:at] + data + sample[at + replaced :])
        assert gray.dtype == np.uint8
        assert gray.size <= IMAGE_PIXELS
