"""The images of a bag: of one topic, or pairs of two, read from the file as they are replayed."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from cairn import SECOND, CairnError
from cairn.components.replay_devices.bag_files import BagFile
from cairn.components.replay_devices.bag_messages import (
    UNREADABLE,
    deserialize,
    error_text,
    message_stamps,
)
from cairn.components.replay_devices.recording import Gray, ImageStream
from cairn.errors import RecordingError
from cairn.schemas.message import InvalidMessage, received_message
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.vision.image_files import camera_of
from cairn.vision.images import decode, gray_of

IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
"""The types of topics that hold images."""

# Images of a pair differ by less than this [ns].
_PAIR_TOLERANCE = SECOND // 100


def image_topics(
    path: Path, types: Mapping[str, str], named: Mapping[str, str]
) -> tuple[list[str], list[str]]:
    """Return the topics of the left (or only) and of the right camera, with notes.

    `types` are those of the bag's topics, `named` the topics named for left_image and right_image.
    None is returned if the bag has no images, or the choice is ambiguous. Raises `RecordingError`
    if a named topic holds no images.
    """
    found = sorted(topic for topic, kind in types.items() if kind in IMAGE_TYPES)
    requested = [named[key] for key in ("left_image", "right_image") if key in named]
    for topic in requested:
        if topic not in found:
            raise RecordingError(
                f"{path}: {topic} is not a topic of images; there "
                f"{'are ' + ', '.join(found) if found else 'is nothing'}."
            )
    if requested or len(found) <= 1:
        return requested or found, []
    sides = {side: [t for t in found if _camera_of_topic(t) == side] for side in ("left", "right")}
    if all(len(topics) == 1 for topics in sides.values()):
        return [*sides["left"], *sides["right"]], []
    return [], [
        f"several topics hold images, so none is replayed: {', '.join(found)}; name one with the "
        "parameter topics.left_image, and the right one of a stereo camera with topics.right_image"
    ]


def bag_images(
    path: Path, topics: list[str], clock_offset: int = 0
) -> tuple[ImageStream, list[str]]:
    """Return the images of one topic, or the pairs of two, with notes on what is left out.

    Times of receipt are ahead of the clock of the stamps by `clock_offset` [ns].

    Raises `RecordingError` if they cannot be read.
    """
    notes: list[str] = []
    times = [_image_times(path, topic, clock_offset, notes) for topic in topics]
    chosen = [list(times[0])]
    if len(topics) == 2:
        chosen = _paired(*times)
        unpaired = sum(len(stamps) for stamps in times) - 2 * len(chosen[0])
        if unpaired:
            notes.append(f"{unpaired} images have no partner, left out")
    if not chosen[0]:
        raise RecordingError(
            f"{path} holds no {'pairs of ' * (len(topics) == 2)}images on {' and '.join(topics)}"
            + (" within 10 ms of each other." if len(topics) == 2 else ".")
        )
    height, width = _first_whole(
        _SequentialImages(path, topics[0], chosen[0]), len(chosen[0])
    ).shape
    readers = [
        _SequentialImages(path, topic, numbers)
        for topic, numbers in zip(topics, chosen, strict=True)
    ]

    def load(index: int) -> tuple[Gray, ...]:
        return tuple(reader.image(index) for reader in readers)

    stamps = [times[0][number] for number in chosen[0]]
    return ImageStream(" and ".join(topics), stamps, len(topics), (width, height), load), notes


def first_calibration(path: Path, topic: str) -> CameraInfo | None:
    """Return the first message of a topic of a ROS 2 bag; None if there is none."""
    _, message = next(_messages_of(path, topic), (0, None))
    return message if isinstance(message, CameraInfo) else None


class _SequentialImages:
    """Images of one topic by their numbers, which must not decrease."""

    def __init__(self, path: Path, topic: str, numbers: list[int]) -> None:
        self._name = f"{path}, topic {topic}"
        self._numbers = numbers
        self._messages = enumerate(_messages_of(path, topic))

    def image(self, index: int) -> Gray:
        for number, (_, message) in self._messages:
            if number == self._numbers[index]:
                return _gray(self._name, number, message)
        raise RecordingError(f"{self._name} ends before image {index + 1}")


def _first_whole(images: _SequentialImages, count: int) -> Gray:
    """Return the first image that is not damaged; raises `RecordingError` if there is none."""
    for index in range(count - 1):
        with suppress(RecordingError):
            return images.image(index)
    return images.image(count - 1)


def _messages_of(path: Path, topic: str) -> Iterator[tuple[int, Any]]:
    """Yield the messages of a topic with their times of receipt [ns]."""
    bag = BagFile(path)
    try:
        for found, received, raw in bag.messages(lambda of: "/" + of.name.lstrip("/") == topic):
            yield received, deserialize(found, raw)
    except UNREADABLE as error:
        raise RecordingError(
            f"{path}: it cannot be read ({error_text(error)}): repair the bag with "
            "`rosbag reindex`, `ros2 bag reindex` or `mcap recover`"
        ) from error


def _image_times(path: Path, topic: str, clock_offset: int, notes: list[str]) -> dict[int, int]:
    """Return the stamps [ns] of a topic's images by their numbers; notes on those left out."""
    received = [(receipt, message.header.stamp) for receipt, message in _messages_of(path, topic)]
    stamps, note = message_stamps(topic, received, clock_offset)
    notes += [note] if note else []
    times: dict[int, int] = {}
    newest = -1
    for number, stamp in enumerate(stamps):
        if stamp > newest:
            times[number] = newest = stamp
    if len(times) < len(stamps):
        notes.append(
            f"{len(stamps) - len(times)} images of {topic} are not later than those before them, "
            "left out"
        )
    return times


def _paired(left: Mapping[int, int], right: Mapping[int, int]) -> list[list[int]]:
    """Return the numbers of left and of right images that make pairs."""
    pairs: list[list[int]] = [[], []]
    others = deque(right.items())
    for number, stamp in left.items():
        while others and others[0][1] < stamp - _PAIR_TOLERANCE:
            others.popleft()
        if others and others[0][1] <= stamp + _PAIR_TOLERANCE:
            pairs[0].append(number)
            pairs[1].append(others.popleft()[0])
    return pairs


def _gray(name: str, number: int, message: Any) -> Gray:
    try:
        if hasattr(message, "format"):
            return decode(f"it ({message.format})", np.asarray(message.data, np.uint8).tobytes())
        fields = ("height", "width", "encoding", "is_bigendian", "step")
        values = {name: getattr(message, name) for name in fields}
        values["data"] = np.asarray(message.data, np.uint8).ravel()
        return gray_of(received_message(Image, values))
    except (CairnError, InvalidMessage) as error:
        raise RecordingError(f"{name}, image {number + 1}: {error}") from error


def _camera_of_topic(topic: str) -> str | None:
    """Return the camera that a part of a topic's name indicates."""
    sides = {camera_of(Path(part)) for part in topic.strip("/").split("/")} - {None}
    return sides.pop() if len(sides) == 1 else None
