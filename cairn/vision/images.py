"""Gray images from files and from messages, of any usual kind."""

from __future__ import annotations

import warnings
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray
from PIL import Image as Picture
from PIL import UnidentifiedImageError

from cairn.errors import CairnError
from cairn.schemas.sensor_msgs import Image
from cairn.vision.file_errors import why

Gray = NDArray[np.uint8]

LEAST_SIDE: Final = 16
"""Smaller images [px] show nothing that could be recognized."""

MOST_PIXELS: Final = 80_000_000
"""Larger images are refused: they would take a robot's memory."""

_JPEG: Final = b"\xff\xd8\xff"  # how such files begin
_ORIENTATION: Final = 0x0112  # Exif 2.3, 4.6.4 A
# What makes an image upright that Exif says is so: turns to the left, mirrored first.
_UPRIGHT: Final = {
    1: (0, False),
    2: (0, True),
    3: (2, False),
    4: (2, True),
    5: (1, True),
    6: (3, False),
    7: (3, True),
    8: (1, False),
}

# Bytes per pixel, bytes per number, and how it becomes gray: None is gray already.
# (sensor_msgs/image_encodings.hpp)
_CHANNELS: Final[dict[str, tuple[int, int, int | None]]] = {
    "mono8": (1, 1, None),
    "8UC1": (1, 1, None),
    "mono16": (2, 2, None),
    "16UC1": (2, 2, None),
    "bgr8": (3, 1, cv2.COLOR_BGR2GRAY),
    "8UC3": (3, 1, cv2.COLOR_BGR2GRAY),
    "rgb8": (3, 1, cv2.COLOR_RGB2GRAY),
    "bgra8": (4, 1, cv2.COLOR_BGRA2GRAY),
    "8UC4": (4, 1, cv2.COLOR_BGRA2GRAY),
    "rgba8": (4, 1, cv2.COLOR_RGBA2GRAY),
    "bgr16": (6, 2, cv2.COLOR_BGR2GRAY),
    "rgb16": (6, 2, cv2.COLOR_RGB2GRAY),
    "bgra16": (8, 2, cv2.COLOR_BGRA2GRAY),
    "rgba16": (8, 2, cv2.COLOR_RGBA2GRAY),
    "bayer_rggb8": (1, 1, cv2.COLOR_BayerRGGB2GRAY),
    "bayer_bggr8": (1, 1, cv2.COLOR_BayerBGGR2GRAY),
    "bayer_gbrg8": (1, 1, cv2.COLOR_BayerGBRG2GRAY),
    "bayer_grbg8": (1, 1, cv2.COLOR_BayerGRBG2GRAY),
    "bayer_rggb16": (2, 2, cv2.COLOR_BayerRGGB2GRAY),
    "bayer_bggr16": (2, 2, cv2.COLOR_BayerBGGR2GRAY),
    "bayer_gbrg16": (2, 2, cv2.COLOR_BayerGBRG2GRAY),
    "bayer_grbg16": (2, 2, cv2.COLOR_BayerGRBG2GRAY),
}
# Of each two bytes that are a pixel, which one is its brightness.
_BRIGHTNESS: Final = {"yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0}


def read_image(path: Path) -> Gray:
    """The image in a file, as `decoded`; `CairnError` as well if it cannot be read."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise CairnError(f"{path} cannot be read: {why(error)}.") from error
    return decoded(str(path), data)


def decoded(what: str, data: bytes) -> Gray:
    """The image in an image file's bytes, gray (h, w), upright as its Exif data say and as viewers
    show it.

    What is transparent becomes white; of 16-bit images see `eight_bits`. Raises `CairnError` with
    `what` it is and what is wrong: empty, no image, truncated, damaged (where the format lets that
    be noticed), too large or too small.
    """
    if not data:
        raise CairnError(f"{what} is empty: give a file that holds an image.")
    orientation = _checked(what, data)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise CairnError(f"{what} cannot be read as an image: {error.err}.") from error
    if pixels is None:
        raise CairnError(f"{what} is no image, or a truncated one: give a PNG, JPEG or TIFF file.")
    if pixels.dtype not in (np.uint8, np.uint16, np.float32):
        raise CairnError(f"{what} holds {pixels.dtype} numbers: give an image of 8 or 16 bits.")
    if pixels.dtype == np.float32 and np.nanmedian(pixels) > 1.0:
        raise CairnError(
            f"{what} holds float32 numbers up to {np.nanmax(pixels):g}, where 1 is white: give an "
            "image of 8 or 16 bits."
        )
    gray = _gray(pixels)
    _check_size(what, gray.shape[1], gray.shape[0])
    turns, mirrored = _UPRIGHT.get(orientation, (0, False))
    return np.ascontiguousarray(np.rot90(gray[:, ::-1] if mirrored else gray, turns))


def upright_size(path: Path) -> tuple[int, int]:
    """Width and height [px] of the image that `read_image` gives, by the file's first bytes alone.

    Raises `CairnError` if it is no image.
    """
    try:
        with warnings.catch_warnings(), Picture.open(path) as picture:
            warnings.simplefilter("ignore")
            width, height = picture.size
            # Pillow decodes all of a PNG image to look for Exif data behind it, where none are, and
            # tells the size of a TIFF image as it is upright.
            told = picture.format != "TIFF" and (picture.format != "PNG" or "exif" in picture.info)
            orientation = int(picture.getexif().get(_ORIENTATION, 1)) if told else 1
    except (OSError, ValueError, SyntaxError) as error:
        raise CairnError(
            f"{path} cannot be read as an image ({error}): take it away, or a fresh copy"
        ) from error
    turns, _ = _UPRIGHT.get(orientation, (0, False))
    return (height, width) if turns % 2 else (width, height)


def gray_of(image: Image) -> Gray:
    """The image in a message, gray (h, w); its own memory where it is gray already.

    Of 16-bit images see `eight_bits`. Raises `CairnError` with the encoding or the size that it
    cannot have.
    """
    what = f"an image of {image.header.frame_id or 'the camera'}"
    width, height, encoding = image.width, image.height, image.encoding
    _check_size(what, width, height)
    if encoding in _BRIGHTNESS:
        rows = _rows(what, image, 2)
        return np.ascontiguousarray(rows[:, _BRIGHTNESS[encoding] :: 2])
    if encoding not in _CHANNELS:
        known = ", ".join((*_CHANNELS, *_BRIGHTNESS))
        raise CairnError(
            f"{what}: encoding = {encoding!r} is not known; have its driver send one of {known}"
        )
    pixel, number, conversion = _CHANNELS[encoding]
    rows = _rows(what, image, pixel)
    if number == 2:
        wide = np.ascontiguousarray(rows).view(">u2" if image.is_bigendian else "<u2")
        values: NDArray[Any] = wide.astype(np.uint16, copy=False)
    else:
        values = rows
    if conversion is not None:
        channels = pixel // number
        shape = (height, width, channels) if channels > 1 else (height, width)
        values = cv2.cvtColor(np.ascontiguousarray(values).reshape(shape), conversion)
    return eight_bits(values)


def eight_bits(gray: NDArray[np.integer[Any]]) -> Gray:
    """An image of uint8 or uint16 with values up to 255.

    Cameras put 8 to 16 bits into 16 without telling how many. So values are shifted by as many
    bits as all but the brightest thousandth need: no image turns black, and no dark one is
    stretched until its noise looks like something.
    """
    if gray.dtype == np.uint8:
        return np.asarray(gray, np.uint8)
    bits = int(np.percentile(gray, 99.9, method="lower")).bit_length()
    return np.asarray(np.minimum(gray >> max(0, bits - 8), 255), np.uint8)


def _checked(what: str, data: bytes) -> int:
    """The orientation that Exif gives; raises `CairnError` if not all of the image is there.

    OpenCV shows what is there of a truncated image, and gray below; of a JPEG image that is damaged
    in its middle Pillow does so too.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what matters of it is told below
        try:
            with Picture.open(BytesIO(data)) as picture:
                _check_size(what, *picture.size)
                if data.startswith(_JPEG) and _is_usual(data):
                    simplejpeg.decode_jpeg(data, colorspace="GRAY", strict=True)
                else:
                    picture.load()
                return int(picture.getexif().get(_ORIENTATION, 1))
        except UnidentifiedImageError:
            return 1  # OpenCV may know it
        except Picture.DecompressionBombError as error:
            raise _too_large(what, str(error)) from error
        except (OSError, SyntaxError, ValueError) as error:
            raise CairnError(
                f"{what} is truncated or damaged ({error}): give a whole image, or save this one "
                "anew if it looks as it should."
            ) from error


def _is_usual(jpeg: bytes) -> bool:
    """Whether a JPEG image is of a kind that libjpeg-turbo's simple interface knows."""
    try:
        simplejpeg.decode_jpeg_header(jpeg, strict=False)
    except (ValueError, KeyError):  # the latter by a subsampling that it does not know
        return False
    return True


def _gray(pixels: NDArray[Any]) -> Gray:
    if pixels.dtype == np.float32:  # of HDR and EXR files: from 0 to 1, and beyond
        pixels = np.rint(np.clip(np.nan_to_num(pixels), 0.0, 1.0) * 255.0).astype(np.uint8)
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    if channels in (2, 4):
        whole = np.iinfo(pixels.dtype).max
        opaque = pixels[..., -1:].astype(np.float32) / whole
        color = pixels[..., :-1].astype(np.float32) * opaque + whole * (1.0 - opaque)
        pixels = np.rint(color).astype(pixels.dtype)
        channels -= 1
    if channels == 3:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)
    return eight_bits(np.asarray(pixels).reshape(pixels.shape[:2]))


def _rows(what: str, image: Image, pixel: int) -> Gray:
    """The bytes of the pixels alone, (height, width * pixel)."""
    length = image.width * pixel
    if image.step < length:
        raise CairnError(
            f"{what}: step = {image.step} is too small for {image.width} pixels of "
            f"{image.encoding}, which have {length} bytes; correct its driver"
        )
    return np.asarray(image.data).reshape(image.height, image.step)[:, :length]


def _check_size(what: str, width: int, height: int) -> None:
    if width * height > MOST_PIXELS:
        raise _too_large(what, f"{width} x {height} pixels")
    if min(width, height) < LEAST_SIDE:
        raise CairnError(
            f"{what} has {width} x {height} pixels: too few to recognize anything. Give one of at "
            f"least {LEAST_SIDE} x {LEAST_SIDE}."
        )


def _too_large(what: str, size: str) -> CairnError:
    return CairnError(
        f"{what} is too large ({size}): make it smaller, at most {MOST_PIXELS // 10**6} megapixels."
    )
