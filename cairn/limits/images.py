"""Decode images of users with limits: known formats, and a size that is checked before decoding.

A header of a few bytes can announce thousands of megapixels. So `read_header` takes the size from
the header itself, and the decoders get nothing but what the format needs for the pixels: chunks of
text, color profiles and animations, which may expand too, are left out.
"""

from __future__ import annotations

import re
import struct
import warnings
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Final, TypeVar

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray
from PIL import Image as Picture

from cairn.errors import CairnError
from cairn.limits.files import megabytes, read_bounded
from cairn.system.files import explained

IMAGE_PIXELS: Final = 25_000_000
"""Most pixels of an image."""

DECODED_BYTES: Final = 4 * IMAGE_PIXELS
"""Most memory that its pixels take [bytes]: 25 megapixels of 8 bits, half of them of 16 bits."""

IMAGE_SIDE: Final = 2**15 - 1
"""Longest side of an image [px], the limit of OpenCV's remapping."""

IMAGE_BYTES: Final = 80_000_000
"""Largest image file [bytes]: `IMAGE_PIXELS` of 3 bytes without compression."""

FORMATS: Final = "PNG, JPEG, PGM, PPM or BMP"
"""The formats of images, for messages."""

# Standard progressive images have 6 to 18 scans; each passes over all pixels again.
_MOST_SCANS: Final = 50
# Of a header before the pixels; Exif, XMP and color profiles take up to 100 segments.
_MOST_SEGMENTS: Final = 1000
# Of a whole PNG file: 80 MB in chunks of 4 kB; common encoders write 8 kB or more.
_MOST_CHUNKS: Final = 20_000

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS: Final = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by type of color (PNG 3, 11.2.1)
_PNG_CHUNKS: Final = (b"PLTE", b"tRNS", b"IDAT", b"IEND")
_JPEG: Final = b"\xff\xd8\xff"
# All that begin a frame, except the tables DHT, JPG and DAC (ITU-T T.81, table B.1).
_JPEG_FRAMES: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# What may precede a frame: DHT, DAC, DQT, DRI, APPn and COM. Others have no length, so that a
# reader that skips one by its length would see another frame than the decoders.
_JPEG_TABLES: Final = frozenset({0xC4, 0xCC, 0xDB, 0xDD, 0xFE, *range(0xE0, 0xF0)})
_JPEG_SIMPLE: Final = ("Gray", "YCbCr", "RGB")  # libjpeg-turbo converts these to RGB
_EXIF: Final = b"Exif\0\0"
_ORIENTATION: Final = 0x0112  # Exif 2.3, 4.6.4 A
_DECODERS_RAISE: Final = (
    OSError, SyntaxError, ValueError, EOFError, struct.error, cv2.error,
    Picture.DecompressionBombError,
)  # fmt: skip
_ROWS: Final = 256  # are converted at once
_GAP: Final = rb"(?:\s|#[^\r\n]*[\r\n])+"
_PNM: Final = re.compile(rb"P([2356])" + 3 * (_GAP + rb"([0-9]{1,9})") + rb"\s")
_PNM_HEADER: Final = 4096  # [bytes], comments included


Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True)
class ImageHeader:
    """Format, size [px] and Exif orientation (1: upright) of an image, from its first bytes."""

    format: str
    width: int
    height: int
    orientation: int = 1


class _UnusualImageError(ValueError):
    """An image is built in a way that is not supported, or would take too long to decode."""


def read_image_file(path: Path) -> bytes:
    """Return the content of an image file; raise `CairnError` if it cannot be read."""
    with explained(f"{path}: cannot be read"):
        return read_bounded(path, IMAGE_BYTES)


def read_header(name: str, stream: BinaryIO) -> ImageHeader:
    """Read the header of an image, without its pixels.

    Raises `CairnError`, which begins with `name`, if the image is of another format, has too many
    pixels, or its header is damaged.
    """
    start = stream.read(_PNM_HEADER)
    try:
        if start.startswith(_PNG):
            header = _png_header(start, stream)
        elif start.startswith(_JPEG):
            header = _jpeg_header(stream)
        elif start.startswith(b"BM"):
            header = _bmp_header(start)
        elif re.match(rb"P[2356][\s#]", start):
            header = _pnm_header(start)
        elif not start:
            raise CairnError(f"{name}: is empty; give an image file")
        elif start.startswith(b"version "):
            raise CairnError(f"{name}: is a pointer of Git LFS to the image; run `git lfs pull`")
        else:
            raise CairnError(
                f"{name}: not an image of a known format, it begins with {start[:8]!r}; give a "
                f"{FORMATS} file"
            )
    except _UnusualImageError as error:
        raise _unusual(name, error) from error
    except struct.error as error:
        raise _damaged(name, "it ends within its header") from error
    except ValueError as error:
        raise _damaged(name, f"its header is not valid: {error}") from error
    if min(header.width, header.height) < 1:
        raise _damaged(name, f"its size is {header.width} x {header.height} pixels")
    check_pixels(name, header.width, header.height)
    return header


def check_pixels(name: str, width: int, height: int) -> None:
    """Raise `CairnError` if an image has more pixels than are allowed."""
    if width * height > IMAGE_PIXELS or max(width, height) > IMAGE_SIDE:
        raise CairnError(
            f"{name}: is too large, {width} x {height} pixels; make it smaller, at most "
            f"{IMAGE_PIXELS // 10**6} megapixels and {IMAGE_SIDE} pixels on a side"
        )


def decode_image(name: str, data: bytes) -> tuple[ImageHeader, NDArray[Any]]:
    """Decode the bytes of an image file: its header and its pixels, as they are stored.

    The pixels are uint8 or uint16, (h, w) for gray, (h, w, 2) for gray and opacity, (h, w, 3) for
    RGB, (h, w, 4) for RGB and opacity; of animations the first picture. Palettes and 1 bit become
    8 bits. Raises `CairnError` as `read_header`, or if the image is truncated or damaged, where
    its format can reveal that.
    """
    header = read_header(name, BytesIO(data))
    decode = {"PNG": _decode_png, "JPEG": _decode_jpeg, "BMP": _decode_bmp, "PNM": _decode_pnm}
    try:
        pixels = decode[header.format](data)
    except _UnusualImageError as error:
        raise _unusual(name, error) from error
    except MemoryError as error:
        raise CairnError(
            f"{name}: there is not enough memory for its {header.width} x {header.height} pixels; "
            "make it smaller"
        ) from error
    except _DECODERS_RAISE as error:
        raise _damaged(name, str(error) or type(error).__name__) from error
    if pixels.shape[:2] != (header.height, header.width):
        raise _damaged(
            name,
            f"it is decoded to {pixels.shape[1]} x {pixels.shape[0]} pixels, but its header has "
            f"{header.width} x {header.height}",
        )
    return header, pixels


def look_up(table: NDArray[Scalar], values: NDArray[Any]) -> NDArray[Scalar]:
    """Return the entries of a table for an array of indices (rows, ...).

    It needs less memory than indexing at once, which makes 8 bytes of each index.
    """
    entries = np.empty(values.shape, table.dtype)
    for row, indices in enumerate(values):
        entries[row] = table[indices]
    return entries


def _unusual(name: str, error: _UnusualImageError) -> CairnError:
    return CairnError(f"{name}: cannot be decoded: {error}; save it again with an image editor")


def _damaged(name: str, reason: str) -> CairnError:
    return CairnError(
        f"{name}: is truncated or damaged ({reason}); give an intact copy, or save it again with "
        "an image editor if it looks right"
    )


def _swap_red_and_blue(pixels: NDArray[Any]) -> NDArray[Any]:
    """Turn BGR, as OpenCV decodes it, into RGB, in place: OpenCV would copy all of it."""
    red = pixels[..., 2].copy()
    pixels[..., 2] = pixels[..., 0]
    pixels[..., 0] = red
    return pixels


# --- PNG ----------------------------------------------------------------------------------------


def _png_header(start: bytes, stream: BinaryIO) -> ImageHeader:
    length, kind, width, height = struct.unpack_from(">I4sII", start, len(_PNG))
    if (length, kind) != (13, b"IHDR"):
        raise ValueError(f"it begins with a chunk {kind!r} of {length} bytes")
    stream.seek(len(_PNG) + 25)
    for _ in range(_MOST_SEGMENTS):
        length, kind = struct.unpack(">I4s", stream.read(8))
        if kind == b"IDAT":
            return ImageHeader("PNG", width, height)
        if kind == b"eXIf":
            return ImageHeader("PNG", width, height, _orientation(stream.read(min(length, 65536))))
        stream.seek(length + 4, 1)
    raise _UnusualImageError(f"more than {_MOST_SEGMENTS} chunks precede the pixels")


def _decode_png(data: bytes) -> NDArray[Any]:
    width, height, bits, color = struct.unpack_from(">IIBB", data, 16)
    channels = _PNG_CHANNELS.get(color, 1)
    size = width * height * channels * max(1, bits // 8)
    if size > DECODED_BYTES:
        raise _UnusualImageError(
            f"its pixels of {bits} bits take {megabytes(size)} MB, more than "
            f"{megabytes(DECODED_BYTES)} MB"
        )
    essential = _essential_chunks(data)
    if bits == 16 and channels > 1:  # Pillow would drop the lower 8 bits
        pixels = cv2.imdecode(np.frombuffer(essential, np.uint8), cv2.IMREAD_UNCHANGED)
        if pixels is None or pixels.ndim != 3:
            raise ValueError("OpenCV cannot decode it")
        return _swap_red_and_blue(pixels)
    return _by_pillow(essential, "PNG")


def _essential_chunks(png: bytes) -> bytes:
    """Return a PNG image without texts, color profiles, animation and other optional chunks."""
    view = memoryview(png)
    parts = [view[: len(_PNG) + 25]]
    at = len(_PNG) + 25
    for _ in range(_MOST_CHUNKS):
        if at + 12 > len(png):
            raise ValueError("it ends before its last chunk")
        length, kind = struct.unpack_from(">I4s", png, at)
        end = at + 12 + length
        if kind in _PNG_CHUNKS:
            parts.append(view[at:end])
        if kind == b"IEND":
            return b"".join(parts)
        at = end
    raise _UnusualImageError(f"it has more than {_MOST_CHUNKS} chunks")


# --- JPEG ---------------------------------------------------------------------------------------


def _jpeg_header(stream: BinaryIO) -> ImageHeader:
    orientation = 1
    stream.seek(2)
    for _ in range(_MOST_SEGMENTS):
        fill, marker, length = struct.unpack(">BBH", stream.read(4))
        if fill != 0xFF or (marker != 0xFF and length < 2):
            raise ValueError(f"it has {fill:02x}{marker:02x} where a marker is expected")
        if marker == 0xFF:  # any number of them may precede a marker
            stream.seek(-3, 1)
        elif marker in _JPEG_FRAMES:
            _, height, width = struct.unpack(">BHH", stream.read(5))
            return ImageHeader("JPEG", width, height, orientation)
        elif marker not in _JPEG_TABLES:
            raise ValueError(f"it has a marker ff{marker:02x} before its frame")
        elif marker == 0xE1 and orientation == 1:
            orientation = _orientation(stream.read(length - 2).removeprefix(_EXIF))
        else:
            stream.seek(length - 2, 1)
    raise _UnusualImageError(f"more than {_MOST_SEGMENTS} segments precede the pixels")


def _decode_jpeg(data: bytes) -> NDArray[Any]:
    scans = data.count(b"\xff\xda")
    if scans > _MOST_SCANS:
        raise _UnusualImageError(f"it has {scans} scans, more than {_MOST_SCANS}")
    try:
        colors = simplejpeg.decode_jpeg_header(data, strict=False)[2]
    except (ValueError, KeyError):  # a sampling that its simple interface does not support
        colors = "other"
    if colors in _JPEG_SIMPLE:
        # In strict mode, because other decoders fill what is missing with gray.
        space = "GRAY" if colors == "Gray" else "RGB"
        pixels: NDArray[Any] = simplejpeg.decode_jpeg(data, colorspace=space, strict=True)
        return pixels[..., 0] if colors == "Gray" else pixels
    decoded = cv2.imdecode(
        np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    )
    if decoded is None:
        raise ValueError("OpenCV cannot decode it")
    return _swap_red_and_blue(decoded)


def _orientation(exif: bytes) -> int:
    """Return the orientation in Exif data, 1 if there is none."""
    order = {b"II": "<", b"MM": ">"}.get(exif[:2])
    if order is None:
        return 1
    try:
        (at,) = struct.unpack_from(f"{order}I", exif, 4)
        (count,) = struct.unpack_from(f"{order}H", exif, at)
        for number in range(count):
            tag, _, _, value = struct.unpack_from(f"{order}HHIH", exif, at + 2 + 12 * number)
            if tag == _ORIENTATION:
                return int(value)
    except struct.error:
        return 1
    return 1


# --- BMP, PGM and PPM ---------------------------------------------------------------------------


def _bmp_header(start: bytes) -> ImageHeader:
    (size,) = struct.unpack_from("<I", start, 14)
    if size == 12:  # OS/2
        width, height = struct.unpack_from("<HH", start, 18)
    else:
        width, height, _, _, compression = struct.unpack_from("<iiHHI", start, 18)
        if compression not in (0, 3):
            raise _UnusualImageError(f"its pixels are compressed by method {compression}")
    return ImageHeader("BMP", width, abs(height))  # below 0: the first row is the top one


def _decode_bmp(data: bytes) -> NDArray[Any]:
    return _by_pillow(data, "BMP")


def _by_pillow(data: bytes, kind: str) -> NDArray[Any]:
    with Picture.open(BytesIO(data), formats=[kind]) as picture, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its errors matter
        picture.load()
        bands = (_band(picture, top) for top in range(0, picture.height, _ROWS))
        first = next(bands)
        if first.dtype not in (np.uint8, np.uint16):
            raise _UnusualImageError(f"its pixels are {picture.mode}, not of 8 or 16 bits")
        pixels = np.empty((picture.height, *first.shape[1:]), first.dtype)
        pixels[: len(first)] = first
        for number, band in enumerate(bands, start=1):
            pixels[number * _ROWS : (number + 1) * _ROWS] = band
    return pixels


def _band(picture: Picture.Image, top: int) -> NDArray[Any]:
    """Return `_ROWS` rows: an array of the whole picture takes its memory three times."""
    band = picture.crop((0, top, picture.width, min(top + _ROWS, picture.height)))
    if "transparency" in picture.info:
        band = band.convert("LA" if picture.mode == "L" else "RGBA")
    elif picture.mode in ("1", "P"):
        band = band.convert("L" if picture.mode == "1" else "RGB")
    return np.asarray(band)


def _match_pnm(data: bytes) -> re.Match[bytes]:
    found = _PNM.match(data[:_PNM_HEADER])
    if found is None or not 1 <= int(found[4]) < 65536:
        raise ValueError("it lacks width, height or the largest value (1 to 65535)")
    return found


def _pnm_header(start: bytes) -> ImageHeader:
    found = _match_pnm(start)
    return ImageHeader("PNM", int(found[2]), int(found[3]))


def _decode_pnm(data: bytes) -> NDArray[Any]:
    found = _match_pnm(data)
    kind, width, height, most = (int(part) for part in found.groups())
    shape = (height, width) if kind in (2, 5) else (height, width, 3)
    number = int(np.prod(shape))
    if kind in (2, 3):
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # NumPy warns of what is not a number
            try:
                values = np.fromstring(data[found.end() :], np.uint16, sep=" ")[:number]
            except (DeprecationWarning, ValueError) as error:
                raise ValueError("its pixels are not numbers") from error
    else:
        words = np.dtype(np.uint8 if most < 256 else ">u2")
        start = found.end()
        # Programs of Windows end the header's lines by two bytes: there is one too many then.
        if data[start - 1 : start + 1] == b"\r\n" and (
            len(data) - start == number * words.itemsize + 1
        ):
            start += 1
        whole = (len(data) - start) // words.itemsize
        values = np.frombuffer(data, words, min(number, whole), start)
    if values.size < number:
        raise ValueError(f"it has {values.size} of {number} values")
    if values.max() > most:
        raise ValueError(f"it has a value above its largest one, {most}")
    kept, white = (np.uint8, 255) if most < 256 else (np.uint16, 65535)
    values = values.reshape(shape)
    if most == white:
        return values.astype(kept, copy=False)
    return look_up(np.rint(np.arange(most + 1) * white / most).astype(kept), values)
