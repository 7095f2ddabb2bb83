"""Small files that ask for much memory or time, or do not end; each reader must refuse them.

`HOSTILE` groups them by what they pretend to be. Each builder writes its file into a folder and
returns its path; all are built in well under a second.
"""

from __future__ import annotations

import bz2
import gzip
import lzma
import os
import socket
import sqlite3
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Final

import lz4.frame
import numpy as np
import zstandard
from PIL import Image

from cairn.visual_map.object_models import add_views
from cairn.visual_map.sqlite_file import create
from tests.cairn.visual_map.views import view
from tests.components.slam.changing_room import ROUND, write_room_graph

MB: Final = 1_000_000


@dataclass(frozen=True)
class HostileFile:
    """A file that a reader must refuse, and a part of the reason that it must give."""

    build: Callable[[Path], Path]
    reason: str


# --- YAML ---------------------------------------------------------------------------------------


def aliases(levels: int = 9, width: int = 9) -> str:
    """Return YAML lines of lists that repeat the list before: width**levels values in all."""
    lines = ["a0: &a0 [" + ", ".join(["1"] * width) + "]"]
    lines += [f"a{k}: &a{k} [" + ", ".join([f"*a{k - 1}"] * width) + "]" for k in range(1, levels)]
    return "\n".join(lines)


def merges(levels: int = 24) -> str:
    """Return YAML lines of mappings that merge the mapping before twice."""
    lines = ["a0: &a0 {x: 1}"]
    lines += [f"a{k}: &a{k} {{<<: [*a{k - 1}, *a{k - 1}]}}" for k in range(1, levels)]
    return "\n".join(lines)


def nested(depth: int) -> str:
    """Return a list in a list in a list ..."""
    return "[" * depth + "]" * depth


def _text(name: str, text: str) -> Callable[[Path], Path]:
    def build(folder: Path) -> Path:
        file = folder / name
        file.write_text(text, encoding="utf-8")
        return file

    return build


def _yaml_files(name: str) -> dict[str, HostileFile]:
    """Return the files that any reader of YAML must refuse."""
    last = aliases().splitlines()[-1].split(":")[0]
    return {
        "aliases": HostileFile(_text(name, f"{aliases()}\nwalls: *{last}\n"), "values"),
        "merges": HostileFile(_text(name, f"{merges()}\nrobot: {{<<: *a23}}\n"), "values"),
        "depth": HostileFile(_text(name, f"walls: {nested(50_000)}\n"), "deep"),
        "self": HostileFile(_text(name, "a: &a [*a]\n"), "itself"),
        "digits": HostileFile(_text(name, f"resolution: {'9' * 5000}\n"), "digits"),
        "size": HostileFile(_text(name, f"# {'x' * 3 * MB}\n"), "MB"),
        "zeros": HostileFile(device("/dev/zero", name), "device"),
        "fifo": HostileFile(fifo(name), "FIFO"),
    }


def device(path: str, name: str) -> Callable[[Path], Path]:
    """Return a builder of a link to a device, such as /dev/zero, which never ends."""

    def build(folder: Path) -> Path:
        file = folder / name
        file.unlink(missing_ok=True)
        file.symlink_to(path)
        return file

    return build


def fifo(name: str) -> Callable[[Path], Path]:
    """Return a builder of a FIFO that no program writes to: opening it blocks for ever."""

    def build(folder: Path) -> Path:
        file = folder / name
        file.unlink(missing_ok=True)
        os.mkfifo(file)
        return file

    return build


def sparse(name: str, size: int, start: bytes = b"") -> Callable[[Path], Path]:
    """Return a builder of a file of `size` bytes that takes no room on the disk."""

    def build(folder: Path) -> Path:
        file = folder / name
        file.write_bytes(start)
        os.truncate(file, size)
        return file

    return build


# --- Images -------------------------------------------------------------------------------------


def zeros_deflated(size: int) -> bytes:
    """Return a zlib stream of `size` zeros, which is about 1000 times smaller."""
    block = 1 << 20
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    piece = packer.compress(bytes(block)) + packer.flush(zlib.Z_FULL_FLUSH)
    last = zlib.compressobj(9, zlib.DEFLATED, -15)
    tail = last.compress(bytes(size % block)) + last.flush()
    checksum = (size % 65521) << 16 | 1  # Adler-32 of zeros
    return b"\x78\xda" + piece * (size // block) + tail + struct.pack(">I", checksum)


def png_chunk(kind: bytes, data: bytes) -> bytes:
    """Return a chunk of a PNG image."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width: int, height: int, *, color: int = 0, bits: int = 8, complete: bool = True) -> bytes:
    """Return a black PNG image; `color`: 0 gray, 2 RGB, 6 RGBA. Incomplete: a header alone."""
    channels = {0: 1, 2: 3, 6: 4}[color]
    row = 1 + (width * channels * bits + 7) // 8
    pixels = zeros_deflated(row * height) if complete else b""
    header = struct.pack(">IIBBBBB", width, height, bits, color, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + png_chunk(b"IHDR", header)
        + png_chunk(b"IDAT", pixels)
        + png_chunk(b"IEND", b"")
    )


_PNG_PIXELS_AT: Final = 33  # the signature and the header precede them


def png_with(chunks: bytes, width: int = 64, height: int = 64, *, complete: bool = True) -> bytes:
    """Return a black PNG image with these chunks before its pixels."""
    image = png(width, height, complete=complete)
    return image[:_PNG_PIXELS_AT] + chunks + image[_PNG_PIXELS_AT:]


def expanding_chunks(number: int) -> bytes:
    """Return color profiles and texts of 1 MB each, compressed to 1 kB."""
    packed = zeros_deflated(MB)
    return (
        png_chunk(b"iCCP", b"p\0\0" + packed)
        + png_chunk(b"zTXt", b"t\0\0" + packed)
        + png_chunk(b"iTXt", b"t\0\1\0\0\0" + packed)
    ) * (number // 3)


def _bytes(name: str, content: Callable[[], bytes]) -> Callable[[Path], Path]:
    def build(folder: Path) -> Path:
        file = folder / name
        file.write_bytes(content())
        return file

    return build


def _tiff_with_huge_tiles() -> bytes:
    """Return a TIFF image of 64 x 64 pixels in one tile of 60,000 x 60,000."""
    tags = [
        (256, 3, 64),  # width
        (257, 3, 64),
        (258, 3, 8),  # bits
        (259, 3, 8),  # deflate
        (262, 3, 1),  # black is zero
        (277, 3, 1),  # samples
        (322, 4, 60_000),  # tile width
        (323, 4, 60_000),
        (324, 4, 8),  # offset of the tile
        (325, 4, 0),  # bytes of the tile
    ]
    pixels = zeros_deflated(60_000 * 60_000 // 1000)
    tags[-1] = (325, 4, len(pixels))
    entries = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags)
    directory = struct.pack("<H", len(tags)) + entries + bytes(4)
    return b"II*\0" + struct.pack("<I", 8 + len(pixels)) + pixels + directory


def jpeg(width: int = 64, height: int = 64, **options: bool) -> bytes:
    """Return a black JPEG image."""
    buffer = BytesIO()
    Image.new("L", (width, height)).save(buffer, "JPEG", **options)
    return buffer.getvalue()


def _jpeg_header(width: int, height: int) -> bytes:
    data = bytearray(jpeg())
    at = data.find(b"\xff\xc0")
    data[at + 5 : at + 9] = struct.pack(">HH", height, width)
    return bytes(data)


def _jpeg_scans(number: int) -> bytes:
    """Return a progressive JPEG image of 24 megapixels whose last scan is repeated."""
    data = jpeg(4900, 4900, progressive=True)
    at = data.rfind(b"\xff\xda")
    return data[:at] + data[at:-2] * number + data[-2:]


def jpeg_with(segments: bytes) -> bytes:
    """Return a JPEG image with these segments at its begin."""
    return b"\xff\xd8" + segments + jpeg()[2:]


def _jpeg_hidden_frame() -> bytes:
    """Return an image that announces 64 pixels to a reader that takes RST0 for a segment."""
    big = jpeg(16, 16, progressive=True)
    at = big.find(b"\xff\xc2")
    frame = big[at : at + 5] + struct.pack(">HH", 65_000, 65_000) + big[at + 9 : at + 13]
    start = b"\xff\xd8\xff\xd0" + frame  # ffc2 is the length of that segment
    small = b"\xff\xc0" + struct.pack(">HBHH", 11, 8, 8, 8) + bytes(4)
    comment = bytes(4 + 0xFFC2 - len(start) - 4) + small
    length = struct.pack(">H", 2 + len(comment))
    return start + b"\xff\xfe" + length + comment + big[2:at] + big[at + 13 :]


def exif_bomb() -> bytes:
    """Return a segment of Exif data with 2,700 entries that each refer to the same 32 kB."""
    entries = b"".join(
        struct.pack("<HHII", 0x9000 + number, 7, 32_000, 32_500) for number in range(2_700)
    )
    content = b"Exif\0\0II*\0" + struct.pack("<IH", 8, 2_700) + entries
    content = content.ljust(65_533, b"\0")
    return b"\xff\xe1" + struct.pack(">H", len(content) + 2) + content


def _bmp(width: int, height: int, compression: int = 0) -> bytes:
    bits = 8 if compression else 24
    return b"BM" + struct.pack(
        "<IIIIiiHHIIIIII", 1000, 0, 54, 40, width, height, 1, bits, compression, 0, 0, 0, 0, 0
    )


def _socket(folder: Path) -> Path:
    file = folder / "socket.png"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(file))
    return file


def avi(frames: Sequence[bytes], claimed: int = 0) -> bytes:
    """Return a video of JPEG images whose header has `claimed` frames, or their number."""
    number = claimed or len(frames)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return kind + struct.pack("<I", len(data)) + data + bytes(len(data) % 2)

    def chunks(kind: bytes, data: bytes) -> bytes:
        return chunk(b"LIST", kind + data)

    main = struct.pack("<14I", 40_000, MB, 0, 0x10, number, 0, 1, MB, 64, 64, 0, 0, 0, 0)
    stream = b"vidsMJPG" + struct.pack("<10I", 0, 0, 0, 1, 25, 0, number, MB, 0, 0)
    picture = struct.pack("<IiiHH4sIiiII", 40, 64, 64, 1, 24, b"MJPG", 0, 0, 0, 0, 0)
    index, at = b"", 4
    for frame in frames:
        index += b"00dc" + struct.pack("<III", 0x10, at, len(frame))
        at += 8 + len(frame) + len(frame) % 2
    streams = chunks(b"strl", chunk(b"strh", stream) + chunk(b"strf", picture))
    return chunk(
        b"RIFF",
        b"AVI "
        + chunks(b"hdrl", chunk(b"avih", main) + streams)
        + chunks(b"movi", b"".join(chunk(b"00dc", frame) for frame in frames))
        + chunk(b"idx1", index),
    )


VIDEOS: Final[Mapping[str, HostileFile]] = {
    "frames": HostileFile(_bytes("a.avi", lambda: avi([jpeg()] * 5, 100 * MB)), "100000000 frames"),
    "pixels": HostileFile(_bytes("a.avi", lambda: avi([jpeg(6_000, 6_000)] * 2)), "megapixels"),
}


_UNKNOWN: Final = "not an image of a known format"

PICTURES: Final[Mapping[str, HostileFile]] = {
    "png_pixels": HostileFile(_bytes("big.png", lambda: png(26_000, 26_000)), "megapixels"),
    "png_rgba16": HostileFile(
        _bytes("deep.png", lambda: png(8_000, 8_000, color=6, bits=16)), "megapixels"
    ),
    "png_header": HostileFile(
        _bytes("bomb.png", lambda: png(200_000, 200_000, complete=False)), "megapixels"
    ),
    "png_side": HostileFile(_bytes("long.png", lambda: png(2_000_000, 5)), "on a side"),
    "png_chunks": HostileFile(
        _bytes("chunks.png", lambda: png_with(png_chunk(b"tEXt", b"a\0b") * 3 * MB)), "chunks"
    ),
    "png_parts": HostileFile(
        _bytes("parts.png", lambda: png_with(png_chunk(b"IDAT", b"") * 6 * MB)), "chunks"
    ),
    "png_profiles": HostileFile(
        _bytes("profiles.png", lambda: png_with(expanding_chunks(900), complete=False)),
        "truncated",
    ),
    "png_late_profiles": HostileFile(
        _bytes(
            "late.png",
            lambda: (
                png(64, 64, complete=False)[:-12]
                + expanding_chunks(19_000)
                + png_chunk(b"IEND", b"")
            ),
        ),
        "truncated",
    ),
    "jpeg_pixels": HostileFile(_bytes("big.jpg", lambda: _jpeg_header(65_000, 65_000)), "megapix"),
    "jpeg_hidden_frame": HostileFile(_bytes("hidden.jpg", _jpeg_hidden_frame), "a marker ffd0"),
    "jpeg_scans": HostileFile(_bytes("scans.jpg", lambda: _jpeg_scans(3_000)), "scans"),
    "jpeg_most_scans": HostileFile(
        _bytes("many.jpg", lambda: _jpeg_scans(44)), "truncated or damaged"
    ),
    "jpeg_segments": HostileFile(
        _bytes("segments.jpg", lambda: jpeg_with(b"\xff\xe3\x00\x02" * 19 * MB)), "segments"
    ),
    "jpeg_fill": HostileFile(_bytes("fill.jpg", lambda: jpeg_with(b"\xff" * 79 * MB)), "segments"),
    "jpeg_exif": HostileFile(
        _bytes("exif.jpg", lambda: jpeg_with(exif_bomb() * 500)[:-20]), "truncated"
    ),
    "pgm_pixels": HostileFile(_text("big.pgm", "P5 65535 65535 255\n"), "megapixels"),
    "pgm_short": HostileFile(_text("short.pgm", "P5 4999 4999 255\nshort"), "5 of 24990001"),
    "pgm_comment": HostileFile(
        _bytes("comment.pgm", lambda: b"P5\n#" + b"#" * 70 * MB + b"\n9 9 255\n" + bytes(81)),
        "header",
    ),
    "pgm_text": HostileFile(
        _bytes("text.pgm", lambda: b"P2 5000 5000 255\n" + b"99 " * 24_999_999), "24999999 of"
    ),
    "pgm_words": HostileFile(_text("words.pgm", "P2 2 2 255\n1 2 many 3\n"), "not numbers"),
    "pgm_white": HostileFile(_text("white.pgm", "P2 2 2 99\n1 2 3 100\n"), "above .* 99"),
    "bmp_pixels": HostileFile(_bytes("big.bmp", lambda: _bmp(60_000, -60_000)), "megapixels"),
    "bmp_rle": HostileFile(_bytes("rle.bmp", lambda: _bmp(4_000, 4_000, 1)), "compressed"),
    "tiff_tiles": HostileFile(_bytes("tiles.tif", _tiff_with_huge_tiles), _UNKNOWN),
    "hdr": HostileFile(_text("big.hdr", "#?RADIANCE\n\n-Y 30000 +X 30000\n"), _UNKNOWN),
    "eps": HostileFile(
        _text("page.eps", "%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 99 99\n%%EndComments\n"),
        _UNKNOWN,
    ),
    "zeros": HostileFile(device("/dev/zero", "zeros.png"), "device"),
    "fifo": HostileFile(fifo("pipe.png"), "FIFO"),
    "socket": HostileFile(_socket, "socket|device"),
    "folder": HostileFile(lambda folder: folder, "directory"),
    "sparse": HostileFile(sparse("sparse.png", 5_000 * MB, b"\x89PNG\r\n\x1a\n"), "MB"),
}


# --- Grid maps ----------------------------------------------------------------------------------


def grid_map(folder: Path, image: str = "map.pgm", **keys: str) -> Path:
    """Write a map's YAML file, with `keys` changed, and a small image beside it."""
    Image.fromarray(np.full((4, 4), 254, np.uint8)).save(folder / "map.pgm")
    described = {
        "image": image,
        "resolution": "0.05",
        "origin": "[0.0, 0.0, 0.0]",
        "negate": "0",
        "occupied_thresh": "0.65",
        "free_thresh": "0.196",
    } | keys
    file = folder / "map.yaml"
    file.write_text("".join(f"{key}: {value}\n" for key, value in described.items()))
    return file


def _map(**keys: str) -> Callable[[Path], Path]:
    return lambda folder: grid_map(folder, **keys)


def _map_with_image(name: str, build: Callable[[Path], Path]) -> Callable[[Path], Path]:
    def with_image(folder: Path) -> Path:
        build(folder)
        return grid_map(folder, image=name)

    return with_image


GRID_MAPS: Final[Mapping[str, HostileFile]] = {
    **_yaml_files("map.yaml"),
    "aliased_origin": HostileFile(
        lambda folder: _text("map.yaml", f"{aliases()}\nimage: map.pgm\norigin: *a8\n")(folder),
        "values",
    ),
    "origin": HostileFile(_map(origin="[1.0e300, 0.0, 0.0]"), "origin"),
    "origin_infinite": HostileFile(_map(origin="[.inf, 0.0, 0.0]"), "origin"),
    "origin_boolean": HostileFile(_map(origin="[true, 0.0, 0.0]"), "origin"),
    "resolution_tiny": HostileFile(_map(resolution="1.0e-300"), "resolution"),
    "resolution_huge": HostileFile(_map(resolution="1.0e+300"), "resolution"),
    "resolution_boolean": HostileFile(_map(resolution="true"), "resolution"),
    "threshold_boolean": HostileFile(_map(occupied_thresh="true"), "occupied_thresh"),
    "threshold": HostileFile(_map(occupied_thresh="7"), "occupied_thresh"),
    "negate": HostileFile(_map(negate="7"), "negate"),
    "date": HostileFile(_map(resolution="2026-99-99"), "2026-99-99"),
    "tag": HostileFile(_map(resolution="!!int 'x'"), "'x'"),
    "image_pixels": HostileFile(
        _map_with_image("big.png", _bytes("big.png", lambda: png(26_000, 26_000))), "megapixels"
    ),
    "image_header": HostileFile(
        _map_with_image(
            "bomb.png", _bytes("bomb.png", lambda: png(200_000, 200_000, complete=False))
        ),
        "megapixels",
    ),
    "image_side": HostileFile(
        _map_with_image("long.png", _bytes("long.png", lambda: png(2_000_000, 5))), "on a side"
    ),
    "image_eps": HostileFile(_map_with_image("page.eps", PICTURES["eps"].build), "image"),
    "image_zeros": HostileFile(
        _map_with_image("zeros.png", device("/dev/zero", "zeros.png")), "device"
    ),
    "image_fifo": HostileFile(_map_with_image("pipe.png", fifo("pipe.png")), "FIFO"),
}


# --- Worlds -------------------------------------------------------------------------------------

_ROOM: Final = "walls:\n- points: [[0, 0], [5, 0], [5, 5], [0, 5], [0, 0]]\nrobot: {x: 1, y: 1}\n"


def world(folder: Path, texture: str) -> Path:
    """Write the world file of a room with an object of that texture."""
    file = folder / "world.yaml"
    file.write_text(f"{_ROOM}objects:\n- {{id: 1, x: 2.0, y: 4.9, texture: {texture}}}\n")
    return file


def _textured(name: str, build: Callable[[Path], Path]) -> Callable[[Path], Path]:
    def with_texture(folder: Path) -> Path:
        build(folder)
        return world(folder, name)

    return with_texture


WORLDS: Final[Mapping[str, HostileFile]] = {
    **_yaml_files("world.yaml"),
    "points": HostileFile(
        _text("world.yaml", f"walls:\n- points: [{'[0, 0],' * 60_000}]\nrobot: {{x: 1, y: 1}}\n"),
        "values",
    ),
    "objects": HostileFile(
        _text(
            "world.yaml",
            _ROOM + "objects:\n" + "".join(f"- {{id: {k}, x: 1, y: 1}}\n" for k in range(1, 5000)),
        ),
        "at most 100 items",
    ),
    "errors": HostileFile(
        _text("world.yaml", f"walls: [{'x,' * 30_000}]\nrobot: {{x: 1, y: 1}}\n"), r"walls\[0\]"
    ),
}

TEXTURES: Final[Mapping[str, HostileFile]] = {
    "zeros": HostileFile(_textured("zeros.png", device("/dev/zero", "zeros.png")), "device"),
    "fifo": HostileFile(_textured("pipe.png", fifo("pipe.png")), "FIFO"),
    "pixels": HostileFile(_textured("big.png", PICTURES["png_pixels"].build), "megapixels"),
}
"""World files that are valid but for the picture on an object."""

DEPLOYMENTS: Final[Mapping[str, HostileFile]] = {
    name: hostile for name, hostile in _yaml_files("robot.yaml").items() if name != "merges"
}
"""Deployments know no merges: `<<` is an unknown key."""

CAMERA_FILES: Final[Mapping[str, HostileFile]] = _yaml_files("camera.yaml")


# --- Recordings ---------------------------------------------------------------------------------


def _gzipped_line() -> bytes:
    """Return 4 MB that expand to one line of 4 GB."""
    member = gzip.compress(b"0 " * 20 * MB, compresslevel=9)
    return gzip.compress(b"FLASER 180 ") + member * 100


def _gzipped_lines() -> bytes:
    """Return 300 kB that expand to 300 MB of valid lines."""
    line = b"ODOM 0.0 0.0 0.0 0.0 0.0 0.0 1.0 robot 1.0\n"
    return gzip.compress(line * (10 * MB // len(line)), compresslevel=9) * 30


def _bad_lines() -> bytes:
    """Return 6 MB of lines of which none is good."""
    return b"ODOM nan 0.0 0.0 0.0 0.0 0.0 1.0 robot 1.0\n" * 140_000


def mcap(
    compression: str, packed: bytes, size: int, *, chunks: int = 1, claim: int | None = None
) -> bytes:
    """Return an MCAP file without index with equal chunks of declared `size`.

    The first chunk's record claims `claim` bytes.
    """

    def text(value: str | bytes) -> bytes:
        raw = value.encode() if isinstance(value, str) else value
        return struct.pack("<I", len(raw)) + raw

    def record(kind: int, content: bytes, length: int | None = None) -> bytes:
        return (
            bytes([kind]) + struct.pack("<Q", len(content) if length is None else length) + content
        )

    schema = record(
        3,
        struct.pack("<H", 1)
        + text("sensor_msgs/msg/LaserScan")
        + text("ros2msg")
        + text("string a\n"),
    )
    channel = record(4, struct.pack("<HH", 1, 1) + text("/scan") + text("cdr") + text(b""))
    magic = b"\x89MCAP0\r\n"
    start = magic + record(1, text("ros2") + text("test")) + schema + channel
    content = struct.pack("<QQQI", 1, 2, size, 0) + text(compression)
    content += struct.pack("<Q", len(packed)) + packed
    data = start + record(6, content, claim) + record(6, content) * (chunks - 1)
    footer = record(2, struct.pack("<QQI", 0, 0, 0))
    return data + record(15, struct.pack("<I", 0)) + footer + magic


def mcap_records(*records: tuple[int, bytes], claim: int | None = None) -> bytes:
    """Return an MCAP file of records (opcode and content); the last one claims `claim` bytes."""
    data = b"\x89MCAP0\r\n" + b"\x01" + struct.pack("<Q", 8) + bytes(8)
    for number, (kind, content) in enumerate(records, start=1):
        size = claim if claim is not None and number == len(records) else len(content)
        data += bytes([kind]) + struct.pack("<Q", size) + content
    return data


def summarized_mcap(*records: tuple[int, bytes], head: bytes = b"") -> bytes:
    """Return an MCAP file with a summary of these records, and nothing else than the `head`."""
    head = head or mcap_records((15, bytes(4)))
    summary = b"".join(bytes([kind]) + struct.pack("<Q", len(one)) + one for kind, one in records)
    footer = b"\x02" + struct.pack("<QQQI", 20, len(head), 0, 0)
    return head + summary + footer + b"\x89MCAP0\r\n"


def _lying_summary(*, attachment: bool) -> bytes:
    """Return a file whose index has a chunk beyond its end, or an attachment of 2^63 bytes."""
    index = struct.pack("<QQQQ", 1, 2, 1 << 63, 100) + struct.pack("<IQIQQ", 0, 0, 0, 0, 0)
    attached = struct.pack("<QQQQQ", 8, 100, 1, 1, 1 << 63) + struct.pack("<II", 0, 0)
    chosen = (10, attached) if attachment else (8, index)
    counts = (1, 0, 0) if attachment else (0, 0, 1)  # attachments, metadata, chunks
    return summarized_mcap(chosen, (11, struct.pack("<QHIIIIQQI", 0, 0, 0, *counts, 1, 2, 0)))


def _indexed_chunks(size: int, *, chunks: int = 1, repeats: int = 1) -> bytes:
    """Return chunks without messages that unpack to `size` bytes, and an index of them.

    The index names each chunk `repeats` times.
    """
    content = b"\x80" + struct.pack("<Q", size - 9) + bytes(size - 9)
    packed = zstandard.compress(content)
    chunk = struct.pack("<QQQII", 1, 2, size, 0, 4) + b"zstd" + struct.pack("<Q", len(packed))
    chunk += packed
    head = mcap_records(*[(6, chunk)] * chunks, (15, bytes(4)))
    first, length = len(mcap_records()), 9 + len(chunk)
    indexes = [
        struct.pack("<QQQQ", 1, 2, first + number * length, length)
        + struct.pack("<IQIQQ", 0, 0, 0, len(packed), size)
        for number in range(chunks)
        for _ in range(repeats)
    ]
    return summarized_mcap(
        *((8, index) for index in indexes),
        (11, struct.pack("<QHIIIIQQI", 0, 0, 0, 0, 0, len(indexes), 1, 2, 0)),
        head=head,
    )


def _repeated_metadata() -> bytes:
    """Return 4 MB whose index names one record of metadata, with 60,000 values, 100,000 times."""
    values = b"".join(struct.pack("<I", 4) + b"%04x" % k + bytes(4) for k in range(60_000))
    record = struct.pack("<I", 1) + b"m" + struct.pack("<I", len(values)) + values
    head = mcap_records((12, record), (15, bytes(4)))
    index = struct.pack("<QQI", len(mcap_records()), 9 + len(record), 1) + b"m"
    return summarized_mcap(
        *[(13, index)] * 100_000,
        (11, struct.pack("<QHIIIIQQI", 0, 0, 0, 0, 100_000, 0, 1, 2, 0)),
        head=head,
    )


def _large_latched_messages() -> bytes:
    """Return 3 MB with 40 latched topics, the last message of each of which has 10 MB."""

    def text(value: bytes) -> bytes:
        return struct.pack("<I", len(value)) + value

    latched = text(text(b"latched") + text(b"true"))
    records = [
        (3, struct.pack("<H", 1) + text(b"a/msg/T") + text(b"ros2msg") + text(b"uint8[] x\n"))
    ]
    records += [
        (4, struct.pack("<HH", number, 1) + text(b"/%d" % number) + text(b"cdr") + latched)
        for number in range(1, 41)
    ]
    data = b"\0\1\0\0" + struct.pack("<I", 10 * MB) + bytes(10 * MB)
    for number in range(1, 41):
        message = struct.pack("<HIQQ", number, 1, number, number) + data
        packed = zstandard.compress(b"\x05" + struct.pack("<Q", len(message)) + message)
        chunk = struct.pack("<QQQI", number, number, 9 + len(message), 0) + text(b"zstd")
        records.append((6, chunk + struct.pack("<Q", len(packed)) + packed))
    return mcap_records(*records, (0x80, bytes(3 * MB)), (15, bytes(4)))


def _overlapping_chunks() -> bytes:
    """Return 40 kB with 40 chunks of 10 MB that all have the same time."""
    message = struct.pack("<HIQQ", 1, 0, 1, 1) + bytes(10 * MB)
    data = b"\x05" + struct.pack("<Q", len(message)) + message
    ballast = (0x80, bytes(3 * MB))  # so that so much may come out of the file
    packed = mcap("zstd", zstandard.compress(data), len(data), chunks=40)
    record = bytes([ballast[0]]) + struct.pack("<Q", len(ballast[1])) + ballast[1]
    at = packed.index(b"\x0f" + struct.pack("<Q", 4))
    return packed[:at] + record + packed[at:]


def _many_channels() -> bytes:
    def channel(number: int) -> bytes:
        return struct.pack("<HHI", number, 0, 1) + b"x" + struct.pack("<I", 3) + b"cdr" + bytes(4)

    return mcap_records(*((4, channel(number)) for number in range(1, 30_000)))


def _channels_of_one_topic() -> bytes:
    def channel(number: int) -> bytes:
        entry = struct.pack("<I", 1) + b"k" + struct.pack("<I", 5) + b"%05d" % number
        head = struct.pack("<HHI", number, 0, 1) + b"x" + struct.pack("<I", 3) + b"cdr"
        return head + struct.pack("<I", len(entry)) + entry

    return mcap_records(*((4, channel(number)) for number in range(1, 19_000)))


def zeros_zstd(size: int) -> bytes:
    """Return zstd frames of `size` zeros, a multiple of 16 MiB."""
    block = 1 << 24
    return zstandard.ZstdCompressor(level=3).compress(bytes(block)) * (size // block)


def _foreign_messages() -> bytes:
    """Return 10 MB of messages of a channel that is not replayed."""
    definition = struct.pack("<H", 2) + struct.pack("<I", 1) + b"x" + bytes(8)
    channel = (
        struct.pack("<HH", 2, 2) + struct.pack("<I", 2) + b"/x" + struct.pack("<I", 3) + b"cdr"
    )
    message = struct.pack("<HIQQ", 2, 0, 1, 1) + bytes(100_000)
    records = [(3, definition), (4, channel + bytes(4)), *[(5, message)] * 100]
    return b"".join(bytes([k]) + struct.pack("<Q", len(c)) + c for k, c in records)


def _many_scans() -> bytes:
    """Return 100 kB that expand to 400,000 scans without beams."""
    body = b"\0\1\0\0" + struct.pack("<iIIB3x", 1, 0, 1, 0) + bytes(4 * 7 + 8)
    content = struct.pack("<HIQQ", 1, 0, 1, 1) + body
    record = b"\x05" + struct.pack("<Q", len(content)) + content
    data = record * 400_000
    return mcap("zstd", zstandard.compress(data), len(data))


def _fields(**fields: bytes) -> bytes:
    entries = [name.encode() + b"=" + value for name, value in fields.items()]
    head = b"".join(struct.pack("<I", len(entry)) + entry for entry in entries)
    return struct.pack("<I", len(head)) + head


def _ros1_record(body: bytes, **fields: bytes) -> bytes:
    return _fields(**fields) + struct.pack("<I", len(body)) + body


def _u32(value: int) -> bytes:
    return struct.pack("<I", value)


def ros1_bag(compression: str, packed: bytes, size: int | None, *, index: bool = True) -> bytes:
    """Return a ROS 1 bag with one chunk of declared `size`."""
    size = len(packed) if size is None else size
    magic = b"#ROSBAG V2.0\n"
    definition = _fields(
        type=b"sensor_msgs/LaserScan",
        md5sum=b"992ce8a1687cec8c8bd883ec73ca41d1",
        message_definition=b"string data\n",
    )[4:]
    connection = _ros1_record(definition, op=b"\x07", conn=_u32(0), topic=b"/scan")
    chunk = _ros1_record(packed, op=b"\x05", compression=compression.encode(), size=_u32(size))
    entries = struct.pack("<III", 1, 0, 0)
    entry = _ros1_record(entries, op=b"\x04", ver=_u32(1), conn=_u32(0), count=_u32(1))
    header_size = 4096
    where = len(magic) + header_size
    info = _ros1_record(
        struct.pack("<II", 0, 1),
        op=b"\x06",
        ver=_u32(1),
        chunk_pos=struct.pack("<Q", where),
        start_time=struct.pack("<II", 1, 0),
        end_time=struct.pack("<II", 1, 0),
        count=_u32(1),
    )
    index_at = where + len(chunk) + len(entry) if index else 0
    fields = _fields(
        op=b"\x03",
        index_pos=struct.pack("<Q", index_at),
        conn_count=_u32(1),
        chunk_count=_u32(1),
    )
    padding = header_size - len(fields) - 4
    header = fields + struct.pack("<I", padding) + b" " * padding
    return magic + header + chunk + entry + connection + info


def zeros_bz2(size: int) -> bytes:
    """Return bzip2 streams of `size` zeros, a multiple of 4.5 MB."""
    block = 45 * MB // 10
    return bz2.compress(bytes(block)) * (size // block)


def zeros_lz4(size: int) -> bytes:
    """Return one LZ4 frame of `size` zeros, a multiple of 4 MiB, without its checksum."""
    block = 1 << 22
    frame: bytes = lz4.frame.compress(bytes(block), store_size=False, block_size=7)
    header, body = frame[:7], frame[7:-4]
    return header + body * (size // block) + frame[-4:]


def _nested_chunks(levels: int = 2000) -> bytes:
    """Return a chunk in a chunk in a chunk ..."""
    inner = b""
    for _ in range(levels):
        inner = _ros1_record(inner, op=b"\x05", compression=b"none", size=_u32(len(inner)))
    return inner


def _ros2_folder(metadata: str) -> Callable[[Path], Path]:
    def build(folder: Path) -> Path:
        bag = folder / "bag"
        bag.mkdir()
        (bag / "metadata.yaml").write_text(metadata)
        return bag

    return build


def _compressed_ros2_folder(folder: Path) -> Path:
    """Write a bag whose file is compressed, 100 kB that expand to 1.3 GB on the disk."""
    bag = folder / "bag"
    bag.mkdir()
    (bag / "bag.db3.zstd").write_bytes(zeros_zstd(10 << 27))
    (bag / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: sqlite3\n"
        "  relative_file_paths: [bag.db3.zstd]\n  duration: {nanoseconds: 1}\n"
        "  starting_time: {nanoseconds_since_epoch: 1}\n  message_count: 1\n"
        "  topics_with_message_count: []\n"
        "  compression_format: zstd\n  compression_mode: FILE\n"
    )
    return bag


def _sqlite_bag(*statements: str) -> Callable[[Path], Path]:
    """Return a builder of a bag of SQLite with these statements for its tables."""
    topics = "CREATE TABLE topics (id INTEGER PRIMARY KEY, name, type, serialization_format)"
    topic = "INSERT INTO topics VALUES (1, '/scan', 'sensor_msgs/msg/LaserScan', 'cdr')"

    def build(folder: Path) -> Path:
        file = folder / "bag.db3"
        with closing(sqlite3.connect(file, isolation_level=None)) as connection:
            for statement in (topics, topic, *statements):
                connection.execute(statement)
        return file

    return build


_MESSAGES: Final = (
    "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
)
_ENDLESS: Final = (
    "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n) "
    "SELECT k AS id, 1 AS topic_id, k AS timestamp, zeroblob(10000000) AS data FROM n"
)

_SCAN_OF_ZEROS: Final = b"FLASER 1000 " + b"0 " * 1006 + b"1 r 1\n"

RECORDINGS: Final[Mapping[str, HostileFile]] = {
    "carmen_line": HostileFile(_bytes("line.log.gz", _gzipped_line), "longer than"),
    "carmen_line_bz2": HostileFile(
        _bytes("line.log.bz2", lambda: bz2.compress(b"FLASER 1 ") + zeros_bz2(1800 * MB)),
        "longer than",
    ),
    "carmen_line_xz": HostileFile(
        _bytes("line.log.xz", lambda: lzma.compress(b"FLASER 1 " + b"0 " * MB, preset=0)),
        "longer than",
    ),
    "carmen_lines": HostileFile(_bytes("lines.log.gz", _gzipped_lines), "lines, the limit"),
    "carmen_scans": HostileFile(
        _bytes("scans.log.gz", lambda: gzip.compress(_SCAN_OF_ZEROS * 8_200)), "16 MB"
    ),
    "carmen_bad": HostileFile(_bytes("bad.log", _bad_lines), "140000 of 140000 records are bad"),
    "carmen_sparse": HostileFile(sparse("s.log", 5_000 * MB, b"ODOM 0 0 0 0 0 0 1 r 1\n"), "MB"),
    "carmen_zeros": HostileFile(device("/dev/zero", "zeros.log"), "device"),
    "carmen_fifo": HostileFile(fifo("pipe.log"), "FIFO"),
    "mcap_zstd": HostileFile(
        _bytes("bomb.mcap", lambda: mcap("zstd", zeros_zstd(4 << 30), 4 << 30)), "MB"
    ),
    "mcap_zstd_liar": HostileFile(
        _bytes("liar.mcap", lambda: mcap("zstd", zeros_zstd(4 << 30), 1000)),
        "more than the 1,000 bytes",
    ),
    "mcap_lz4": HostileFile(
        _bytes("lz4.mcap", lambda: mcap("lz4", zeros_lz4(1 << 30), 1 << 30)), "MB"
    ),
    "mcap_messages": HostileFile(_bytes("many.mcap", _many_scans), "memory"),
    "mcap_chunks": HostileFile(
        _bytes(
            "chunks.mcap",
            lambda: mcap(
                "zstd", zstandard.compress(_foreign_messages()), len(_foreign_messages()), chunks=40
            ),
        ),
        "64 MB",
    ),
    "mcap_record": HostileFile(
        _bytes("record.mcap", lambda: mcap("", b"", 0, claim=1 << 62)), "claims"
    ),
    "ros1_bz2": HostileFile(
        _bytes("bomb.bag", lambda: ros1_bag("bz2", zeros_bz2(2970 * MB), 1000)),
        "more than the 1,000 bytes",
    ),
    "ros1_bz2_unindexed": HostileFile(
        _bytes("cut.bag", lambda: ros1_bag("bz2", zeros_bz2(2970 * MB), 1000, index=False)),
        "more than the 1,000 bytes",
    ),
    "ros1_lz4": HostileFile(
        _bytes("lz4.bag", lambda: ros1_bag("lz4", zeros_lz4(1 << 30), 1000)),
        "more than the 1,000 bytes",
    ),
    "ros1_nested": HostileFile(
        _bytes("nested.bag", lambda: ros1_bag("none", _nested_chunks(), None, index=False)),
        "in another chunk",
    ),
    "ros1_sparse": HostileFile(sparse("sparse.bag", 5_000 * MB, b"#ROSBAG V2.0\n"), "no message"),
    "ros2_view": HostileFile(_sqlite_bag(f"CREATE VIEW messages AS {_ENDLESS}"), "the view"),
    "ros2_computed": HostileFile(
        _sqlite_bag(
            "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
            "data BLOB AS (zeroblob(900000000)))",
            "INSERT INTO messages VALUES (1, 1, 1)",
        ),
        "computed",
    ),
    "ros2_trigger": HostileFile(
        _sqlite_bag(
            _MESSAGES, "CREATE TRIGGER t AFTER INSERT ON messages BEGIN DELETE FROM topics; END"
        ),
        "the trigger",
    ),
    "ros2_blob": HostileFile(
        _sqlite_bag(_MESSAGES, "INSERT INTO messages VALUES (1, 1, 1, zeroblob(129000000))"),
        "too big",
    ),
    "ros2_metadata": HostileFile(_ros2_folder(f"{merges()}\nb: {{<<: *a23}}\n"), "values"),
    "ros2_depth": HostileFile(_ros2_folder(nested(50_000)), "deep"),
    "ros2_compressed": HostileFile(_compressed_ros2_folder, "MB"),
}


MCAPS: Final[Mapping[str, HostileFile]] = {
    "chunks": RECORDINGS["mcap_chunks"],
    "size": HostileFile(
        _bytes("a.mcap", lambda: mcap_records((6, bytes(99)), claim=1 << 63)), "claims"
    ),
    "summary": HostileFile(
        _bytes("a.mcap", lambda: _lying_summary(attachment=False)), "9,223,372,036,854,775,808"
    ),
    "attachment": HostileFile(
        _bytes("a.mcap", lambda: _lying_summary(attachment=True)), "another record"
    ),
    "overlap": HostileFile(_bytes("a.mcap", _overlapping_chunks), "belong to one time"),
    "channels": HostileFile(_bytes("a.mcap", _many_channels), "20,000 channels"),
    "one_topic": HostileFile(_bytes("a.mcap", _channels_of_one_topic), "not closed"),
    "indexed_bomb": HostileFile(
        _bytes("a.mcap", lambda: _indexed_chunks(120 * MB, chunks=300)), "unpacks to more than"
    ),
    "repeated_chunk": HostileFile(
        _bytes("a.mcap", lambda: _indexed_chunks(60 * MB, repeats=2_000)), "a chunk twice"
    ),
    "repeated_metadata": HostileFile(
        _bytes("a.mcap", _repeated_metadata), "metadata at byte 25 twice"
    ),
    "latched": HostileFile(_bytes("a.mcap", _large_latched_messages), "last messages of its"),
    "garbage": HostileFile(
        _bytes("a.mcap", lambda: b"\x89MCAP0\r\n" + b"\0\xff" * MB), "no record"
    ),
    "foreign": HostileFile(_text("a.mcap", "hello"), "is not an MCAP file"),
    "fifo": HostileFile(fifo("a.mcap"), "FIFO"),
    "sparse": HostileFile(sparse("a.mcap", 5_000 * MB, b"\x89MCAP0\r\n"), "no record"),
}


# --- Visual maps --------------------------------------------------------------------------------


def visual_map(folder: Path, *statements: str) -> Path:
    """Make an empty visual map and execute SQL statements in it."""
    file = folder / "map.cairn"
    create(file, "test").close()
    with closing(sqlite3.connect(file, isolation_level=None)) as connection:
        for statement in statements:
            connection.execute(statement)
    return file


def _map_after(*statements: str) -> Callable[[Path], Path]:
    return lambda folder: visual_map(folder, *statements)


def objects(number: int, name: str = "'x'") -> str:
    """Return SQL that adds so many valid objects without checksum."""
    return (
        f"WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n WHERE k < {number}) "
        "INSERT INTO objects (object_id, name, reliability, state, evidence_count) "
        f"SELECT k, {name}, 0.5, 0, 0 FROM n"
    )


_TRIGGER: Final = (
    "CREATE TRIGGER t AFTER INSERT ON evidence BEGIN UPDATE objects SET reliability = 1.0; END"
)


def _map_with_big_picture(folder: Path) -> Path:
    """Write a map with an object model whose picture is a PNG of a few kB and 900 megapixels."""
    file = visual_map(folder)
    add_views(file, "cup", [view(1)])
    with closing(sqlite3.connect(file)) as connection, connection:
        connection.execute("UPDATE taught_views SET picture = ?", (png(30_000, 30_000),))
    return file


def _map_with_many_pictures(folder: Path) -> Path:
    """Write a map of 1 MB with 40 views of 25 megapixels."""
    file = visual_map(folder)
    big = replace(view(1), width=5_000, height=5_000)
    add_views(file, "cup", [big] * 40)
    with closing(sqlite3.connect(file)) as connection, connection:
        connection.execute("UPDATE taught_views SET picture = ?", (png(5_000, 5_000),))
    return file


def _map_of_repeated_pages(folder: Path) -> Path:
    """Write a map whose table `objects` is a tree in which pages occur again and again.

    Each inner page has the same page several times as its child, at 8 levels.
    """
    file = visual_map(folder, objects(20_000))
    with closing(sqlite3.connect(file)) as connection:
        (size,) = connection.execute("PRAGMA page_size").fetchone()
        (root,) = connection.execute(
            "SELECT rootpage FROM sqlite_schema WHERE name = 'objects'"
        ).fetchone()
    data = bytearray(file.read_bytes())
    begin = (root - 1) * size
    assert data[begin] == 5  # an inner page of a table
    (cells,) = struct.unpack_from(">H", data, begin + 3)
    pages = [len(data) // size + level for level in range(1, 9)]
    (leaf,) = struct.unpack_from(">I", data, begin + struct.unpack_from(">H", data, begin + 12)[0])
    for level, page in enumerate([root, *pages]):
        copy = bytearray(data[begin : begin + size])
        child = pages[level] if level < len(pages) else leaf
        for cell in range(cells):
            (at,) = struct.unpack_from(">H", copy, 12 + 2 * cell)
            struct.pack_into(">I", copy, at, child)
        struct.pack_into(">I", copy, 8, child)
        data[(page - 1) * size : page * size] = copy
    struct.pack_into(">I", data, 28, len(data) // size)
    file.write_bytes(data)
    return file


VISUAL_MAPS: Final[Mapping[str, HostileFile]] = {
    "objects": HostileFile(_map_after(objects(300_000)), "300,000"),
    "long_name": HostileFile(_map_after(objects(1, "hex(zeroblob(1000000))")), "name"),
    "trigger": HostileFile(_map_after(_TRIGGER), "trigger"),
    "view": HostileFile(_map_after("CREATE VIEW extra AS SELECT * FROM objects"), "extra"),
    "view_for_table": HostileFile(
        _map_after(
            "ALTER TABLE changes RENAME TO real_changes",
            "CREATE VIEW changes AS SELECT * FROM real_changes",
        ),
        "changes",
    ),
    "virtual_table": HostileFile(
        _map_after("CREATE VIRTUAL TABLE extra USING fts5(text)"), "extra"
    ),
    "table": HostileFile(_map_after("CREATE TABLE extra (a)"), "extra"),
    "index": HostileFile(_map_after("CREATE INDEX extra ON objects (name)"), "extra"),
    "generated_column": HostileFile(
        _map_after("ALTER TABLE evidence ADD COLUMN g AS (hex(zeroblob(1000000)))"), "evidence"
    ),
    "no_checksum": HostileFile(_map_after(objects(1)), "checksum"),
    "infinite": HostileFile(
        _map_after(
            "INSERT INTO objects (object_id, name, reliability, state, evidence_count, x, y, xx, "
            "xy, yy) VALUES (1, 'x', 0.5, 0, 0, 1e300, 0, 1, 0, 1)"
        ),
        "farther than",
    ),
    "overflow": HostileFile(
        _map_after(
            "INSERT INTO objects (object_id, name, reliability, state, evidence_count) "
            "VALUES (1, 'x', 0.5, 0, 9e999)"
        ),
        "infinity",
    ),
    "nested_viewpoints": HostileFile(
        _map_after(
            objects(1),
            f"UPDATE objects SET viewpoints = '{nested(40_000)}'",
        ),
        "recursion",
    ),
    "picture": HostileFile(_map_with_big_picture, "megapixels"),
    "pictures": HostileFile(_map_with_many_pictures, "megapixels"),
    "pages": HostileFile(_map_of_repeated_pages, "page"),
    "zeros": HostileFile(device("/dev/zero", "map.cairn"), "regular"),
    "fifo": HostileFile(fifo("map.cairn"), "regular"),
    "sparse": HostileFile(sparse("map.cairn", 5_000 * MB, b"SQLite format 3\0"), "MB"),
}


def _zones(geometry: str, properties: str = '"zone": "keepout", "name": "a"') -> str:
    feature = f'{{"type": "Feature", "properties": {{{properties}}}, "geometry": {geometry}}}'
    return f'{{"type": "FeatureCollection", "features": [{feature}]}}'


def _polygon(corners: int) -> str:
    ring = ", ".join(f"[{k % 1000}.5, {k // 1000}]" for k in range(corners))
    return f'{{"type": "Polygon", "coordinates": [[{ring}, [0.5, 0]]]}}'


_ZONES: Final = "map.zones.geojson"
ZONE_FILES: Final[Mapping[str, HostileFile]] = {
    "nested": HostileFile(_text(_ZONES, nested(1_000_000)), "not a zones file"),
    "nested_below": HostileFile(_text(_ZONES, _zones(nested(90))), "geometry"),
    "corners": HostileFile(_text(_ZONES, _zones(_polygon(200_000))), "at most 1000"),
    "features": HostileFile(
        _text(_ZONES, f'{{"type": "FeatureCollection", "features": [{"1," * 3_000_000}1]}}'),
        "at most 200",
    ),
    "rings": HostileFile(
        _text(_ZONES, _zones(f'{{"type": "Polygon", "coordinates": [{"[]," * 500_000}[]]}}')),
        "four positions",
    ),
    "huge_number": HostileFile(
        _text(_ZONES, _zones('{"type": "Point", "coordinates": [1e999, 0]}')), "too large"
    ),
    "long_name": HostileFile(
        _text(_ZONES, _zones(_polygon(3), f'"zone": "keepout", "name": "{"a" * 10_000_000}"')),
        "1 to 64 characters",
    ),
    "too_large": HostileFile(sparse(_ZONES, 17 << 20), "MB"),
    "device": HostileFile(device("/dev/zero", _ZONES), "device"),
    "fifo": HostileFile(fifo(_ZONES), "FIFO"),
}

# --- Graphs of maps -----------------------------------------------------------------------------


def _graph_after(*statements: str) -> Callable[[Path], Path]:
    """Return a builder of a graph of two scans in which SQL statements were executed."""

    def build(folder: Path) -> Path:
        file = folder / "map.graph"
        write_room_graph(file, [], ROUND[:2])
        with closing(sqlite3.connect(file, isolation_level=None)) as connection:
            for statement in statements:
                connection.execute(statement)
        return file

    return build


_MANY_KEYFRAMES: Final = (
    "WITH RECURSIVE n(k) AS (SELECT 2 UNION ALL SELECT k + 1 FROM n WHERE k < 600000) "
    "INSERT INTO {} SELECT {} FROM n"
)

GRAPHS: Final[Mapping[str, HostileFile]] = {
    "trigger": HostileFile(
        _graph_after("CREATE TRIGGER t AFTER INSERT ON lives BEGIN DELETE FROM poses; END"),
        "trigger",
    ),
    "view": HostileFile(_graph_after("CREATE VIEW extra AS SELECT * FROM poses"), "extra"),
    "table": HostileFile(_graph_after("CREATE TABLE extra (a)"), "extra"),
    "no_table": HostileFile(_graph_after("DROP TABLE places"), "tables are missing"),
    "other_format": HostileFile(_graph_after("PRAGMA user_version = 77"), "newer"),
    "old_format": HostileFile(_graph_after("PRAGMA user_version = 1"), "older"),
    "other_file": HostileFile(_graph_after("PRAGMA application_id = 1"), "not a graph"),
    "no_graph": HostileFile(_graph_after("DELETE FROM graph"), "damaged"),
    "version": HostileFile(_graph_after("UPDATE graph SET oldest = 5"), "version"),
    "huge_version": HostileFile(_graph_after("UPDATE graph SET version = 1 << 40"), "version"),
    "infinite_pose": HostileFile(_graph_after("UPDATE poses SET x = 9e999"), "not finite"),
    "text_pose": HostileFile(_graph_after("UPDATE poses SET x = 'here'"), "damaged"),
    "no_pose": HostileFile(_graph_after("DELETE FROM poses WHERE number = 1"), "missing"),
    "no_keyframe": HostileFile(_graph_after("DELETE FROM keyframes WHERE number = 1"), "missing"),
    "long_value": HostileFile(
        _graph_after("UPDATE keyframes SET cloud = zeroblob(100000000)"), "too big"
    ),
    "odd_cloud": HostileFile(_graph_after("UPDATE keyframes SET cloud = x'0102'"), "damaged"),
    "infinite_cloud": HostileFile(
        _graph_after("UPDATE keyframes SET cloud = x'0000807f0000807f0000807f0000807f'"),
        "not finite",
    ),
    "tile": HostileFile(_graph_after("INSERT INTO places VALUES (0, 0, 0, NULL, x'00')"), "damag"),
    "text_tile": HostileFile(
        _graph_after("INSERT INTO places VALUES ('a', 0, 0, NULL, zeroblob(1024))"), "place"
    ),
    "edge": HostileFile(_graph_after("UPDATE edges SET first = 99"), "missing"),
    "edge_kind": HostileFile(_graph_after("UPDATE edges SET kind = 99"), "damaged"),
    "change": HostileFile(
        _graph_after("INSERT INTO changes VALUES (1, 'now', '', 0, 0, 0, 0, 0, 0, '')"), "change 1"
    ),
    "many_keyframes": HostileFile(
        _graph_after(
            _MANY_KEYFRAMES.format(
                "keyframes", "k, 0, 0, 0, zeroblob(24), zeroblob(0), NULL, NULL"
            ),
            _MANY_KEYFRAMES.format("lives", "k, 0, NULL"),
            _MANY_KEYFRAMES.format("poses", "k, 0, 0, 0"),
        ),
        "more than 500000",
    ),
    "zeros": HostileFile(device("/dev/zero", "map.graph"), "is not a file"),
    "fifo": HostileFile(fifo("map.graph"), "is not a file"),
    "sparse": HostileFile(sparse("map.graph", 5_000 * MB, b"SQLite format 3\0"), "MB"),
}


HOSTILE: Final[Mapping[str, Mapping[str, HostileFile]]] = {
    "deployment": DEPLOYMENTS,
    "world": WORLDS,
    "texture": TEXTURES,
    "grid_map": GRID_MAPS,
    "camera_file": CAMERA_FILES,
    "picture": PICTURES,
    "video": VIDEOS,
    "recording": RECORDINGS,
    "mcap": MCAPS,
    "visual_map": VISUAL_MAPS,
    "zones": ZONE_FILES,
    "graph": GRAPHS,
}
