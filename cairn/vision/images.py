"""Decodes images from files and messages to gray, and checks files for damage."""

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
from cairn.files import explain_os_error
from cairn.schemas.sensor_msgs import Image

Gray = NDArray[np.uint8]

LEAST_SIDE: Final = 16
"""Shortest side [px]: nothing can be recognized in smaller images."""

MOST_PIXELS: Final = 80_000_000
"""Larger images are rejected: they would exhaust a robot's memory."""

_JPEG: Final = b"\xff\xd8\xff"  # first bytes of a file
_ORIENTATION: Final = 0x0112  # Exif 2.3, 4.6.4 A
# Exif orientation -> quarter turns to the left and whether to mirror first, to make it upright.
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

# Bytes per pixel, bytes per channel, and the conversion to gray (None: already gray).
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
# Index of the luminance byte among the two bytes of a pixel.
_LUMINANCE: Final = {"yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0}


def read_image(path: Path) -> Gray:
    """Read and decode an image file; raise `CairnError` as `decode`, or if it cannot be read."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise CairnError(f"{path} cannot be read: {explain_os_error(error)}.") from error
    return decode(str(path), data)


def decode(name: str, data: bytes) -> Gray:
    """Decode the bytes of an image file to a gray image (h, w), upright according to its Exif data.

    Transparent pixels become white; for 16-bit images see `eight_bits`. Raises `CairnError`, which
    begins with `name`, if the file is empty, not an image, truncated, damaged (where its format
    can reveal that), too large or too small.
    """
    if not data:
        raise CairnError(f"{name} is empty: give an image file.")
    orientation = _check_damage(name, data)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise CairnError(f"{name} cannot be read as an image: {error.err}.") from error
    if pixels is None:
        raise CairnError(f"{name} is not an image, or is truncated: give a PNG, JPEG or TIFF file.")
    if pixels.dtype not in (np.uint8, np.uint16, np.float32):
        raise CairnError(f"{name} has {pixels.dtype} pixels: give an image of 8 or 16 bits.")
    if pixels.dtype == np.float32 and np.nanmedian(pixels) > 1.0:
        raise CairnError(
            f"{name} has float32 pixels up to {np.nanmax(pixels):g}, but 1 is white: give an "
            "image of 8 or 16 bits."
        )
    gray = _gray(pixels)
    _check_size(name, gray.shape[1], gray.shape[0])
    turns, mirrored = _UPRIGHT.get(orientation, (0, False))
    return np.ascontiguousarray(np.rot90(gray[:, ::-1] if mirrored else gray, turns))


def upright_size(path: Path) -> tuple[int, int]:
    """Return width and height [px] of the image that `read_image` returns, without decoding it.

    Raises `CairnError` if the file is not an image.
    """
    try:
        with warnings.catch_warnings(), Picture.open(path) as picture:
            warnings.simplefilter("ignore")
            width, height = picture.size
            # Pillow decodes a whole PNG image to search for Exif data after it, and returns the
            # upright size of a TIFF image.
            has_exif = picture.format != "TIFF" and (
                picture.format != "PNG" or "exif" in picture.info
            )
            orientation = int(picture.getexif().get(_ORIENTATION, 1)) if has_exif else 1
    except (OSError, ValueError, SyntaxError) as error:
        raise CairnError(
            f"{path} cannot be read as an image ({error}): remove it, or replace it by a fresh copy"
        ) from error
    turns, _ = _UPRIGHT.get(orientation, (0, False))
    return (height, width) if turns % 2 else (width, height)


def gray_of(image: Image) -> Gray:
    """Convert an image message to gray (h, w); a gray image is returned without a copy.

    For 16-bit images see `eight_bits`. Raises `CairnError` with the encoding or the size if it is
    not valid.
    """
    name = f"an image of {image.header.frame_id or 'the camera'}"
    width, height, encoding = image.width, image.height, image.encoding
    _check_size(name, width, height)
    if encoding in _LUMINANCE:
        rows = _rows(name, image, 2)
        return np.ascontiguousarray(rows[:, _LUMINANCE[encoding] :: 2])
    if encoding not in _CHANNELS:
        known = ", ".join((*_CHANNELS, *_LUMINANCE))
        raise CairnError(
            f"{name}: encoding = {encoding!r} is not supported; set its driver to send one of "
            f"{known}"
        )
    pixel, number, conversion = _CHANNELS[encoding]
    rows = _rows(name, image, pixel)
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
    """Convert an image of uint8 or uint16 to uint8.

    Cameras put 8 to 16 significant bits into 16-bit pixels, and messages do not say how many. So
    values are shifted by the number of bits that all but the brightest thousandth of the pixels
    need: no image turns black, and a dark one is not stretched until its noise has structure.
    """
    if gray.dtype == np.uint8:
        return np.asarray(gray, np.uint8)
    bits = int(np.percentile(gray, 99.9, method="lower")).bit_length()
    return np.asarray(np.minimum(gray >> max(0, bits - 8), 255), np.uint8)


def _check_damage(name: str, data: bytes) -> int:
    """Raise `CairnError` if an image file is truncated or damaged; return its Exif orientation.

    OpenCV decodes truncated images and fills them with gray; Pillow does the same with a JPEG
    image that is damaged in the middle, so those are checked by libjpeg-turbo in strict mode.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # errors below report name matters
        try:
            with Picture.open(BytesIO(data)) as picture:
                _check_size(name, *picture.size)
                if data.startswith(_JPEG) and _is_supported_jpeg(data):
                    simplejpeg.decode_jpeg(data, colorspace="GRAY", strict=True)
                else:
                    picture.load()
                return int(picture.getexif().get(_ORIENTATION, 1))
        except UnidentifiedImageError:
            return 1  # OpenCV may support the format
        except Picture.DecompressionBombError as error:
            raise _too_large(name, str(error)) from error
        except (OSError, SyntaxError, ValueError) as error:
            raise CairnError(
                f"{name} is truncated or damaged ({error}): give an intact copy, or save it "
                "again with an image editor if it looks right."
            ) from error


def _is_supported_jpeg(jpeg: bytes) -> bool:
    """Return whether libjpeg-turbo's simple interface supports a JPEG image."""
    try:
        simplejpeg.decode_jpeg_header(jpeg, strict=False)
    except (ValueError, KeyError):  # KeyError: unknown subsampling
        return False
    return True


def _gray(pixels: NDArray[Any]) -> Gray:
    if pixels.dtype == np.float32:  # HDR and EXR files: 0 to 1, and beyond
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


def _rows(name: str, image: Image, pixel: int) -> Gray:
    """Return the bytes of the pixels without padding, (height, width * pixel)."""
    length = image.width * pixel
    if image.step < length:
        raise CairnError(
            f"{name}: step = {image.step} is too small for {image.width} pixels of "
            f"{image.encoding}, which take {length} bytes; correct its driver"
        )
    return np.asarray(image.data).reshape(image.height, image.step)[:, :length]


def _check_size(name: str, width: int, height: int) -> None:
    if width * height > MOST_PIXELS:
        raise _too_large(name, f"{width} x {height} pixels")
    if min(width, height) < LEAST_SIDE:
        raise CairnError(
            f"{name} has {width} x {height} pixels, too few to recognize anything: give one of at "
            f"least {LEAST_SIDE} x {LEAST_SIDE}."
        )


def _too_large(name: str, size: str) -> CairnError:
    return CairnError(
        f"{name} is too large ({size}): make it smaller, at most {MOST_PIXELS // 10**6} megapixels."
    )
