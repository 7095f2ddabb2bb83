"""Compress; decompress with limits, because a few bytes of a file may stand for gigabytes."""

from __future__ import annotations

import bz2
import sys
from collections.abc import Callable, Mapping
from typing import Any, Final

from lz4 import frame as lz4

from cairn.limits.files import megabytes

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

RECORD_BYTES: Final = 128_000_000
"""Longest record or decompressed chunk of a recording [bytes]."""

_DECOMPRESSORS: Final[Mapping[str, Callable[[], Any]]] = {
    "bz2": bz2.BZ2Decompressor,
    "lz4": lz4.LZ4FrameDecompressor,
    "zstd": zstd.ZstdDecompressor,
}


def pack(data: bytes, compression: str) -> bytes:
    """Return bytes compressed by "zstd" or "lz4", or as they are for "none"."""
    if compression == "none":
        return data
    compress = {"zstd": zstd.compress, "lz4": lz4.compress}[compression]
    return bytes(compress(data))


def unpack(packed: bytes, compression: str, size: int, *, cut_off: bool = False) -> bytes:
    """Return the `size` bytes that a chunk of a bag declares to hold.

    Of a chunk that is `cut_off`, return the bytes that come out of what is there. Memory stays
    below `size`, whatever the chunk holds. Raises `ValueError` if more or, of a whole chunk, fewer
    bytes come out, or the compression is not known.
    """
    if size > RECORD_BYTES:
        raise ValueError(
            f"it declares {megabytes(size)} MB, more than the {megabytes(RECORD_BYTES)} MB that "
            "are allowed"
        )
    if compression in ("", "none"):
        data = packed
    elif compression not in _DECOMPRESSORS:
        raise ValueError(f"its compression {compression[:20]!r} is not known")
    else:
        data = _unpacked_frame(packed, _DECOMPRESSORS[compression](), size, cut_off=cut_off)
    if len(data) > size or (len(data) < size and not cut_off):
        more = "more" if len(data) > size else f"{len(data):,}, not"
        raise ValueError(f"{more} than the {size:,} bytes that it declares come out of it")
    return data


def _unpacked_frame(packed: bytes, decompressor: Any, size: int, *, cut_off: bool = False) -> bytes:
    """Return what one frame holds, but at most `size` + 1 bytes."""
    pieces = []
    rest, left = packed, size + 1
    try:
        while left and not decompressor.eof:
            piece = decompressor.decompress(rest, left)
            if not piece and decompressor.needs_input:
                if cut_off:
                    break
                raise ValueError("it is cut off")
            pieces.append(piece)
            rest, left = b"", left - len(piece)
    except (OSError, EOFError, RuntimeError, MemoryError, zstd.ZstdError) as error:
        raise ValueError(f"it cannot be decompressed ({error})") from error
    if decompressor.unused_data:
        raise ValueError(f"{len(decompressor.unused_data):,} bytes follow its compressed data")
    return pieces[0] if len(pieces) == 1 else b"".join(pieces)


def is_zstd(data: bytes) -> bool:
    """Return whether data are a frame of zstd (RFC 8878, 3.1.1); no message begins like that."""
    return data[:4] == b"\x28\xb5\x2f\xfd"


def unpack_message(packed: bytes) -> bytes:
    """Return a message that rosbag2 compressed by zstd; raise `ValueError` as `unpack`."""
    data = _unpacked_frame(packed, zstd.ZstdDecompressor(), RECORD_BYTES)
    if len(data) > RECORD_BYTES:
        raise ValueError(f"a message unpacks to more than {megabytes(RECORD_BYTES)} MB")
    return data
