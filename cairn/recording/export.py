"""Exports recorded messages: tables (CSV, Parquet), trajectories (TUM), images (PNG, JPEG).

Each topic becomes a file such as `robot.pose.csv`, or a folder of images.
"""

from __future__ import annotations

import csv
import errno
import json
from collections.abc import Collection, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from hashlib import blake2b
from io import BytesIO
from pathlib import Path
from typing import Any, Final, Protocol, TextIO, cast
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc

from cairn.bus.codec import to_plain
from cairn.errors import CairnError, RecordingError
from cairn.recording.decoding import Definition, MessageDecoder
from cairn.recording.mcap_file import Progress, RecordedChannel, RecordedMessage
from cairn.recording.reader import McapRecording
from cairn.recording.tum import TUM_HEADER, stamp_text, tum_line
from cairn.schemas.sensor_msgs import pixel_layout
from cairn.system.clock import SECOND
from cairn.system.files import explain_os_error, replace_file, replacing

_MOST_TOPICS: Final = 200  # files that are open at once
_MOST_NAMED: Final = 10
_LONGEST_NAME: Final = 150
_MOST_COLUMNS: Final = 2_000
_DEEPEST: Final = 30
_ROWS: Final = 1_000  # of a Parquet file that are kept in memory,
_ROW_BYTES: Final = 16_000_000  # or messages of this size
_JPEG_QUALITY: Final = 92
_IMAGES: Final = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_POSES: Final = ("geometry_msgs/msg/Pose", "geometry_msgs/msg/PoseWithCovariance")


@dataclass
class Exported:
    """What was written: the number of messages by file or folder; `notes` on what was left out."""

    files: dict[Path, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


class _Sheet(Protocol):
    """Takes the decoded messages of one topic."""

    def add(self, recorded: RecordedMessage, message: Any, /) -> bool:
        """Write a message; return False if it holds nothing to write."""

    def close(self) -> None:
        """Write what is left: nothing, if messages are written at once."""
        return


def export_recording(
    recording: McapRecording,
    file_format: str,
    folder: Path,
    channels: Collection[RecordedChannel],
    start_ns: int = 0,
    end_ns: int = 2**64,
    *,
    named: bool = False,
    force: bool = False,
    progress: Progress | None = None,
) -> Exported:
    """Write the messages of some channels from `start_ns` to `end_ns` into files in a folder.

    Topics that the format cannot hold are left out with a note, and so are images in tables; if the
    user has `named` the topics, the former is an error, and tables hold images too. Tables and
    trajectories appear when all of them are complete. Existing files are replaced with `force`
    only. Raises `RecordingError`.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            export = _Export(file_format, folder, named, force, stack)
            for of in _by_file(channels):
                export.open(of)
            if not export.sheets:
                raise RecordingError(
                    f"{recording.files[0]}: there is no topic to export as {file_format}; choose "
                    f"another format or other topics (`cairn recording info`)"
                )
            for one in recording.messages(start_ns, end_ns, export.sheets, progress):
                export.add(one)
            export.close()
    except OSError as error:
        name = error.filename or folder
        raise RecordingError(f"{name}: cannot be written: {explain_os_error(error)}") from error
    return export.exported


class _UnsuitableError(Exception):
    """A topic cannot be written in a format."""


class _Export:
    """The files of one export, which are open at the same time."""

    def __init__(
        self, file_format: str, folder: Path, named: bool, force: bool, stack: ExitStack
    ) -> None:
        self.exported = Exported()
        self.sheets: dict[RecordedChannel, tuple[Path, _Sheet]] = {}
        self._format, self._folder, self._named, self._force = file_format, folder, named, force
        self._stack = stack
        self._decoder = MessageDecoder()
        self._failures: dict[str, tuple[int, str]] = {}
        self._left_out: dict[str, list[str]] = {}

    def open(self, channels: list[RecordedChannel]) -> None:
        """Create the file, or the folder, of one topic."""
        channel = channels[0]
        try:
            try:
                definition = self._decoder.definition(channel)
            except RecordingError as error:
                raise _UnsuitableError(str(error)) from error
            opened = self._sheet(channel, definition)
        except _UnsuitableError as error:
            if self._named:
                raise RecordingError(f"{channel.topic}: {error}") from error
            self._left_out.setdefault(str(error), []).append(channel.topic)
            return
        self.exported.files[opened[0]] = 0
        self.sheets |= dict.fromkeys(channels, opened)
        if len(self.exported.files) > _MOST_TOPICS:
            raise RecordingError(f"more than {_MOST_TOPICS} topics; choose some with --topic")

    def add(self, one: RecordedMessage) -> None:
        """Write a message to the file of its topic."""
        file, sheet = self.sheets[one.channel]
        try:
            self.exported.files[file] += sheet.add(one, self._decoder.decode(one))
        except CairnError as error:
            count, first = self._failures.get(one.channel.topic, (0, str(error)))
            self._failures[one.channel.topic] = (count + 1, first)

    def close(self) -> None:
        """Complete the files; note which messages were left out."""
        for sheet in {id(sheet): sheet for _, sheet in self.sheets.values()}.values():
            sheet.close()
        for reason, topics in self._left_out.items():
            more = len(topics) - _MOST_NAMED
            listed = ", ".join(topics[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
            self.exported.notes.append(f"left out, because {reason}: {listed}")
        self.exported.notes += [
            f"{count:,} messages of {topic} are left out, the first: {first}"
            for topic, (count, first) in self._failures.items()
        ]

    def _sheet(self, channel: RecordedChannel, definition: Definition) -> tuple[Path, _Sheet]:
        is_image = channel.type in _IMAGES
        if self._format in ("png", "jpeg"):
            if not is_image:
                raise _UnsuitableError("it holds no images")
            images = self._unused(channel, "")
            images.mkdir(exist_ok=True)
            return images, _Images(images, self._format)
        if self._format == "tum" and not _has_pose(definition):
            raise _UnsuitableError("it has no header with a pose")
        if is_image and not self._named:
            raise _UnsuitableError("images are exported by --format png or jpeg")
        file = self._unused(channel, f".{self._format}")
        columns = _columns(definition)
        part = self._stack.enter_context(replacing(file, durable=False))
        if self._format == "parquet":
            return file, _Parquet(part, columns, definition, self._stack)
        stream = self._stack.enter_context(part.open("w", encoding="utf-8", newline=""))
        return file, _Tum(stream) if self._format == "tum" else _Csv(stream, columns)

    def _unused(self, channel: RecordedChannel, suffix: str) -> Path:
        """Return the path of a topic's file, which does not exist yet or may be replaced."""
        name = _file_name(channel.topic)
        path = self._folder / f"{name}{suffix}"
        if path in self.exported.files:  # two definitions of one topic
            digest = blake2b(repr(channel).encode(), digest_size=4).hexdigest()
            path = self._folder / f"{name}-{digest}{suffix}"
        if path.exists() and not self._force and (path.is_file() or any(path.iterdir())):
            raise FileExistsError(errno.EEXIST, "it exists; replace it with --force", str(path))
        return path


def _by_file(channels: Collection[RecordedChannel]) -> list[list[RecordedChannel]]:
    """Return the channels of each topic; those of another definition of it apart."""
    groups: dict[tuple[str, str, str, bytes], list[RecordedChannel]] = {}
    for one in sorted(channels, key=lambda one: (one.topic, one.type, one.node, one.gid)):
        groups.setdefault((one.topic, one.type, one.type_hash, one.schema), []).append(one)
    return list(groups.values())


def _file_name(topic: str) -> str:
    """Return a file's name for a topic: `robot.pose` for `/robot/pose`."""
    parts = [quote(part, safe="").replace(".", "%2E") for part in topic.strip("/").split("/")]
    name = ".".join(parts)
    if len(name) > _LONGEST_NAME:
        name = f"{name[:_LONGEST_NAME]}-{blake2b(topic.encode(), digest_size=4).hexdigest()}"
    return name or "topic"


# --- Tables -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _FieldColumn:
    """A field, of the message itself or of a message in it: its name with dots, and its type."""

    name: str
    path: tuple[str, ...]
    kind: FieldDesc

    def value(self, message: Any) -> Any:
        """Return the field's value in a decoded message."""
        for name in self.path:
            message = message[name] if isinstance(message, dict) else getattr(message, name)
        return message


_HEAD: Final = ("publisher", "sequence", "log_time_ns", "publish_time_ns")


def _head(recorded: RecordedMessage) -> tuple[str, int, int, int]:
    return (
        recorded.channel.node or recorded.channel.gid,
        recorded.sequence,
        recorded.log_ns,
        recorded.publish_ns,
    )


def _columns(definition: Definition) -> list[_FieldColumn]:
    """Return the fields of a type; those of a message in it are columns of their own."""
    columns: list[_FieldColumn] = []

    def add(name: str, path: tuple[str, ...]) -> None:
        for part, kind in definition.fields(name):
            if kind[0] == Nodetype.NAME and len(path) < _DEEPEST:
                add(str(kind[1]), (*path, part))
            else:
                columns.append(_FieldColumn(".".join((*path, part)), (*path, part), kind))
            if len(columns) > _MOST_COLUMNS:
                raise RecordingError(f"{definition.name} has more than {_MOST_COLUMNS:,} fields")

    add(definition.name, ())
    return columns


class _Csv(_Sheet):
    """A table with a row for each message; sequences are JSON in one cell."""

    def __init__(self, stream: TextIO, columns: list[_FieldColumn]) -> None:
        self._columns = columns
        self._writer = csv.writer(stream, lineterminator="\n")
        self._writer.writerow([*_HEAD, *(column.name for column in columns)])

    def add(self, recorded: RecordedMessage, message: Any, /) -> bool:
        """Write a row."""
        cells = [_cell(column.value(message)) for column in self._columns]
        self._writer.writerow([*_head(recorded), *cells])
        return True


def _cell(value: Any) -> str:
    plain = to_plain(value)
    if isinstance(plain, str):
        return plain
    return repr(plain) if isinstance(plain, float) else json.dumps(plain, ensure_ascii=False)


class _Parquet(_Sheet):
    """A Parquet file with a row for each message; bytes are binary, sequences lists."""

    def __init__(
        self, part: Path, columns: list[_FieldColumn], definition: Definition, stack: ExitStack
    ) -> None:
        try:
            import pyarrow
            from pyarrow import parquet
        except ImportError as error:
            raise RecordingError(
                "Parquet needs pyarrow, which is not installed; install it with "
                "`pip install 'cairn-robotics[parquet]'`"
            ) from error
        self._arrow = pyarrow
        self._columns = columns
        self._kinds = 0
        kinds = ["string", "uint32", "uint64", "uint64"]
        fields = [pyarrow.field(name, kind) for name, kind in zip(_HEAD, kinds, strict=True)]
        fields += [pyarrow.field(one.name, self._kind(definition, one.kind)) for one in columns]
        self._schema = pyarrow.schema(fields)
        self._writer = stack.enter_context(
            parquet.ParquetWriter(part, self._schema, compression="zstd")
        )
        self._rows: list[list[Any]] = []
        self._bytes = 0

    def add(self, recorded: RecordedMessage, message: Any, /) -> bool:
        """Keep a row; write those that are kept if they are many."""
        values = [_value(column.value(message), column.kind) for column in self._columns]
        self._rows.append([*_head(recorded), *values])
        self._bytes += len(recorded.data)
        if len(self._rows) >= _ROWS or self._bytes >= _ROW_BYTES:
            self.close()
        return True

    def close(self) -> None:
        """Write the rows that are kept."""
        if self._rows:
            arrays = [
                self._arrow.array(values, type=of.type)
                for values, of in zip(zip(*self._rows, strict=True), self._schema, strict=True)
            ]
            self._writer.write_table(self._arrow.Table.from_arrays(arrays, schema=self._schema))
        self._rows, self._bytes = [], 0

    def _kind(self, definition: Definition, kind: FieldDesc, depth: int = 0) -> Any:
        arrow = self._arrow
        if kind[0] == Nodetype.BASE:
            return getattr(arrow, _ARROW[kind[1][0]])()
        if kind[0] == Nodetype.NAME:
            if depth > _DEEPEST:
                raise RecordingError(f"{definition.name} is nested deeper than {_DEEPEST} levels")
            self._kinds += 1
            if self._kinds > _MOST_COLUMNS:
                raise RecordingError(f"{definition.name} has more than {_MOST_COLUMNS:,} messages")
            fields = definition.fields(str(kind[1]))
            return arrow.struct(
                [(name, self._kind(definition, of, depth + 1)) for name, of in fields]
            )
        if _is_bytes(kind):
            return arrow.binary()
        return arrow.list_(self._kind(definition, cast("FieldDesc", kind[1][0]), depth + 1))


_ARROW: Final[Mapping[str, str]] = {
    "bool": "bool_",
    "byte": "uint8",
    "char": "uint8",
    "string": "string",
    **{f"{sign}int{bits}": f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
    **{f"float{bits}": f"float{bits}" for bits in (32, 64)},
}


def _is_bytes(kind: FieldDesc) -> bool:
    element = cast("FieldDesc", kind[1][0])
    return element[0] == Nodetype.BASE and element[1][0] in ("uint8", "byte", "char")


def _value(value: Any, kind: FieldDesc) -> Any:
    if kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) and _is_bytes(kind):
        return np.asarray(value, np.uint8).tobytes()
    return to_plain(value)


# --- Trajectories -------------------------------------------------------------------------------


def _has_pose(definition: Definition) -> bool:
    fields = dict(definition.fields(definition.name))
    header, pose = fields.get("header"), fields.get("pose")
    return (
        header == (Nodetype.NAME, "std_msgs/msg/Header")
        and pose is not None
        and pose[0] == Nodetype.NAME
        and pose[1] in _POSES
    )


class _Tum(_Sheet):
    """The poses of a topic; those that the publisher marks as not `located` are left out."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        stream.write(TUM_HEADER)

    def add(self, _: RecordedMessage, message: Any, /) -> bool:
        """Write a line."""
        plain = to_plain(message)
        if not plain.get("located", True):
            return False
        pose = plain["pose"].get("pose", plain["pose"])
        self._stream.write(tum_line(_stamp_ns(plain["header"]), _numbers(pose)))
        return True


def _stamp_ns(header: Mapping[str, Any]) -> int:
    return int(header["stamp"]["sec"]) * SECOND + int(header["stamp"]["nanosec"])


def _numbers(pose: Mapping[str, Mapping[str, float]]) -> list[float]:
    position, turn = pose["position"], pose["orientation"]
    return [*(position[axis] for axis in "xyz"), *(turn[axis] for axis in "xyzw")]


# --- Images -------------------------------------------------------------------------------------


# OpenCV's conversion to gray or blue, green, red.
_CONVERSIONS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("mono8", "mono16", "8UC1", "16UC1", "8UC3", "8UC4"), ""),
    **dict.fromkeys(("bgr8", "bgr16", "bgra8"), ""),
    **dict.fromkeys(("rgb8", "rgb16"), "RGB2BGR"),
    "rgba8": "RGBA2BGRA",
    **dict.fromkeys(("yuv422", "uyvy"), "YUV2BGR_UYVY"),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), "YUV2BGR_YUY2"),
    **{
        f"bayer_{order}{bits}": f"Bayer{order.upper()}2BGR"
        for order in ("rggb", "bggr", "gbrg", "grbg")
        for bits in (8, 16)
    },
}
_SUFFIXES: Final = {"png": (".png",), "jpeg": (".jpg", ".jpeg")}


class _Images(_Sheet):
    """A folder of images, which are named by their stamps [s]."""

    def __init__(self, folder: Path, file_format: str) -> None:
        self._folder = folder
        self._format = file_format
        self._last: tuple[int, int] = (-1, 0)

    def add(self, recorded: RecordedMessage, message: Any, /) -> bool:
        """Write an image; one that is compressed in the format already as it is."""
        plain = {name: _field(message, name) for name in ("header", "data")}
        stamp = _stamp_ns(to_plain(plain["header"]))
        topic = f"{recorded.channel.topic}, message {recorded.sequence}"
        data = np.asarray(plain["data"], np.uint8)
        if recorded.channel.type == "sensor_msgs/msg/CompressedImage":
            encoded = self._recoded(topic, data.tobytes())
        else:
            encoded = self._encode(topic, _pixels(topic, message, data))
        self._last = (stamp, self._last[1] + 1 if self._last[0] == stamp else 0)
        number = f"_{self._last[1]}" if self._last[1] else ""
        file = self._folder / f"{stamp_text(stamp)}{number}{_SUFFIXES[self._format][0]}"
        replace_file(file, encoded, durable=False)
        return True

    def _recoded(self, name: str, data: bytes) -> bytes:
        from cairn.limits.images import decode_image, read_header  # which need OpenCV

        header = read_header(name, BytesIO(data))
        if header.format.lower() == self._format:
            return data
        _, pixels = decode_image(name, data)
        if pixels.ndim == 3 and pixels.shape[2] == 2:  # gray with opacity
            pixels = pixels[..., 0]
        if pixels.ndim == 3:
            pixels = pixels[..., [2, 1, 0, *range(3, pixels.shape[2])]]
        return self._encode(name, pixels)

    def _encode(self, name: str, pixels: NDArray[Any]) -> bytes:
        import cv2  # an extra: only exporting images needs it

        if self._format == "jpeg":
            if pixels.dtype != np.uint8:
                raise RecordingError(f"{name}: has 16 bits, which JPEG cannot hold; export PNG")
            pixels = pixels[..., :3] if pixels.ndim == 3 else pixels
        options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY] if self._format == "jpeg" else []
        written, encoded = cv2.imencode(
            _SUFFIXES[self._format][0], np.ascontiguousarray(pixels), options
        )
        if not written:
            raise RecordingError(f"{name}: cannot be encoded as {self._format}")
        return bytes(encoded)


def _field(message: Any, name: str) -> Any:
    return message[name] if isinstance(message, dict) else getattr(message, name)


def _pixels(name: str, message: Any, data: NDArray[np.uint8]) -> NDArray[Any]:
    """Return the pixels of an image message, in OpenCV's order of colors."""
    import cv2

    from cairn.limits.images import check_pixels

    encoding = str(_field(message, "encoding"))
    width, height = int(_field(message, "width")), int(_field(message, "height"))
    step = int(_field(message, "step"))
    layout = pixel_layout(encoding)
    if layout is None or encoding not in _CONVERSIONS:
        raise RecordingError(
            f"{name}: its encoding {encoding[:40]!r} is not supported; those are "
            f"{', '.join(_CONVERSIONS)}"
        )
    check_pixels(name, width, height)
    conversion, (size, numbers) = _CONVERSIONS[encoding], layout
    dtype = np.dtype(f"u{size}").newbyteorder(">" if _field(message, "is_bigendian") else "<")
    row = width * numbers * dtype.itemsize
    if min(width, height) < 1 or step < row or data.size < step * (height - 1) + row:
        raise RecordingError(
            f"{name}: has {data.size:,} bytes, which are not {width} x {height} pixels with rows "
            f"of {step:,} bytes"
        )
    rows = np.lib.stride_tricks.as_strided(data, (height, row), (step, 1), writeable=False)
    shape = (height, width, numbers) if numbers > 1 else (height, width)
    pixels = np.ascontiguousarray(rows).view(dtype).astype(dtype.newbyteorder("=")).reshape(shape)
    if not conversion:
        return pixels
    converted: NDArray[Any] = cv2.cvtColor(pixels, getattr(cv2, f"COLOR_{conversion}"))
    return converted
