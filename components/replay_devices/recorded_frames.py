"""The scanner's mount and the robot's frames in an MCAP recording, by the few messages about them.

`cairn map build` and a replay read a recording as a whole, and find the same.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final

from cairn.components.replay_devices.bag_files import BagTopic, ros2_type
from cairn.components.replay_devices.bag_messages import (
    ODOMETRY_TYPE,
    SCAN_TYPE,
    TRANSFORM_TYPES,
    UNREADABLE,
    deserialize,
    error_text,
    is_description,
    scan_of,
    usual_topic,
)
from cairn.components.replay_devices.recording import ScannerMount
from cairn.components.replay_devices.scanner_mount import (
    FrameLink,
    find_mount,
    links_of_description,
    links_of_transforms,
)
from cairn.errors import RecordingError
from cairn.recording.mcap_file import RecordedChannel
from cairn.recording.reader import McapRecording
from cairn.schemas.message import InvalidMessage
from cairn.schemas.sensor_msgs import LaserScan

# Of a topic so many messages are read at most, so many bytes of them, and of blocks that have them.
_MOST_MESSAGES: Final = 10_000
_MOST_MESSAGE_BYTES: Final = 32_000_000
_MOST_BYTES: Final = 256_000_000


@dataclass
class RecordedFrames:
    """What the first messages of a recording say about the robot.

    Attributes:
        scan_topic: of the scanner, "" if there is none, or several.
        scanner: frame of its scans.
        scan: the first one, mirrored if the scanner is upside down.
        mount: of the scanner on the robot.
        odometry: frame that odometry moves, and in which one; None without odometry.
        links: fixed transforms between frames.
        notes: what could not be read or found, as sentences.

    """

    scan_topic: str = ""
    scanner: str = ""
    scan: LaserScan | None = None
    mount: ScannerMount | None = None
    odometry: tuple[str, str] | None = None
    links: list[FrameLink] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def read_frames(recording: McapRecording) -> RecordedFrames:
    """Return the mount and the frames by a recording's first scan and odometry, and its frames.

    Of the transforms only those on topics `tf_static` are read, and the description of the robot.
    """
    reader, found = _Reader(recording), RecordedFrames()
    found.notes = reader.notes
    found.scan_topic, scan = reader.first("scan", SCAN_TYPE)
    _, odometry = reader.first("odom", ODOMETRY_TYPE)
    if odometry is not None:
        moved, fixed = odometry.child_frame_id, odometry.header.frame_id
        found.odometry = moved.strip("/"), fixed.strip("/")
    static = [
        link
        for topic in reader.topics(_is_static)
        for link in links_of_transforms(
            topic.name, (one for message in reader.messages(topic) for one in message.transforms)
        )
    ]
    described = _described_links(reader)
    found.links = [*static, *described]
    if scan is None:
        return found
    found.scanner = scan.header.frame_id.strip("/")
    bases = () if found.odometry is None else (found.odometry[0],)
    mount = find_mount(static, lambda: described, found.scanner, bases)
    if isinstance(mount, str):
        found.notes.append(mount)
    else:
        found.mount = mount
    try:
        found.scan = scan_of(0, scan, found.mount is not None and found.mount.upside_down)
    except (InvalidMessage, ValueError) as error:
        found.notes.append(f"the first message of {found.scan_topic} is invalid: {error}")
    return found


def _described_links(reader: _Reader) -> list[FrameLink]:
    """Return the links of the robot's description; of several, that of the shortest name."""
    topics = reader.topics(is_description)
    topic = min(topics, key=lambda one: (len(one.name), one.name), default=None)
    newest = deque(() if topic is None else reader.messages(topic), maxlen=1)
    if topic is None or not newest:
        return []
    try:
        return links_of_description(topic.name, newest[0].data)
    except RecordingError as error:
        reader.notes.append(str(error))
        return []


def _is_static(topic: BagTopic) -> bool:
    return topic.type in TRANSFORM_TYPES and topic.name.rpartition("/")[2] == "tf_static"


class _Reader:
    """Reads messages of few topics; what is wrong with them becomes a note."""

    def __init__(self, recording: McapRecording) -> None:
        self.notes: list[str] = []
        self._recording = recording
        self._channels: dict[BagTopic, list[RecordedChannel]] = {}
        for channel in recording.channels:
            if channel.encoding == "cdr" and recording.counts[channel]:
                topic = BagTopic("/" + channel.topic.lstrip("/"), ros2_type(channel.type))
                self._channels.setdefault(topic, []).append(channel)

    def first(self, kind: str, type_name: str) -> tuple[str, Any]:
        """Return the topic that is replayed as `kind`, and its first message; "" and None."""
        found = sorted(topic.name for topic in self._channels if topic.type == type_name)
        name = usual_topic(kind, found) or (found[0] if len(found) == 1 else None)
        if name is None:
            if found:
                self.notes.append(
                    f"several topics have the type {type_name}: {', '.join(found)}; `cairn "
                    f"recording show` and `cairn map build` need --{kind}"
                )
            return "", None
        return name, next(self.messages(BagTopic(name, type_name)), None)

    def topics(self, wanted: Callable[[BagTopic], bool]) -> list[BagTopic]:
        """Return the topics that are wanted."""
        return [topic for topic in self._channels if wanted(topic)]

    def messages(self, topic: BagTopic) -> Iterator[Any]:
        """Yield the messages of a topic, up to the limits."""
        read_bytes = message_bytes = 0

        def progress(done: int, _total: int) -> None:
            nonlocal read_bytes
            read_bytes = done

        channels = self._channels[topic]
        try:
            for number, one in enumerate(
                self._recording.messages(channels=channels, progress=progress)
            ):
                message_bytes += len(one.data)
                if (
                    number == _MOST_MESSAGES
                    or message_bytes > _MOST_MESSAGE_BYTES
                    or read_bytes > _MOST_BYTES
                ):
                    self.notes.append(
                        f"only the first {number:,} messages of {topic.name} were read; `cairn "
                        "recording show` reads all"
                    )
                    return
                yield deserialize(topic, one.data)
        except (RecordingError, *UNREADABLE) as error:
            self.notes.append(f"{topic.name} cannot be read: {error_text(error)}")
