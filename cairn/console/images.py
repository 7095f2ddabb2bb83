"""Images as JPEG: a browser gets them at a twentieth of the length, encoded once for all."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
import simplejpeg

from cairn.bus.codec import Codec
from cairn.console.protocol import jpeg_payload
from cairn.errors import CairnError
from cairn.schemas.message import InvalidMessage, type_name
from cairn.schemas.sensor_msgs import Image

IMAGE_TYPE: Final = type_name(Image)

_QUALITY: Final = 80
_COLORS: Final = {
    "rgb8": "RGB", "8UC3": "BGR", "bgr8": "BGR", "rgba8": "RGBA", "bgra8": "BGRA",
    "mono8": "GRAY", "8UC1": "GRAY",
}  # fmt: skip
_CHANNELS: Final = {"GRAY": 1, "RGB": 3, "BGR": 3, "RGBA": 4, "BGRA": 4}
_DEEP: Final = frozenset({"mono16", "16UC1"})
_codec: Final = Codec()


def to_jpeg(payload: bytes) -> bytes:
    """Return an image in CDR as JPEG with its width and height in front.

    16-bit images become gray, the brightest pixel white. Raises `CairnError` if the image is not
    valid or has another encoding.
    """
    try:
        image = _codec.decode(Image, payload)
    except InvalidMessage as error:
        raise CairnError(f"the image is not valid: {error}") from error
    if not 0 < image.width <= 65_500 or not 0 < image.height <= 65_500:
        raise CairnError(f"an image of {image.width} x {image.height} pixels cannot be a JPEG")
    pixels, color = _pixels(image)
    try:
        jpeg: Any = simplejpeg.encode_jpeg(
            np.ascontiguousarray(pixels), quality=_QUALITY, colorspace=color, fastdct=True
        )
    except ValueError as error:
        raise CairnError(f"the image cannot be a JPEG: {error}") from error
    return jpeg_payload(image.width, image.height, bytes(jpeg))


def _pixels(image: Image) -> tuple[npt.NDArray[np.uint8], str]:
    """Return the pixels (height, width, channels), and their colors as the encoder names them."""
    color = _COLORS.get(image.encoding)
    size = _CHANNELS[color] if color is not None else 2
    if color is None and image.encoding not in _DEEP:
        known = ", ".join([*_COLORS, *sorted(_DEEP)])
        raise CairnError(
            f"images of encoding {image.encoding!r} cannot be sent as JPEG; it can be {known}"
        )
    if image.step < image.width * size:
        raise CairnError(
            f"the image is not valid: step = {image.step} is less than {image.width} pixels of "
            f"{size} bytes"
        )
    rows = image.data.reshape(image.height, image.step)[:, : image.width * size]
    if color is not None:
        return rows.reshape(image.height, image.width, size), color
    deep = np.ascontiguousarray(rows).view(">u2" if image.is_bigendian else "<u2")
    brightest = max(1, int(deep.max()))
    gray = (deep.astype(np.uint32) * 255 // brightest).astype(np.uint8)
    return gray[:, :, np.newaxis], "GRAY"
