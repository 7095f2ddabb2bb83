"""Images in ROS bags, read from the file as they are replayed: all at once they fill the memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from cairn import SECOND, CairnError
from cairn.components.replay.bag_times import own_stamps
from cairn.components.replay.recording import Gray, Images, RecordingError
from cairn.schemas.message import InvalidMessage
from cairn.schemas.sensor_msgs import Image
from cairn.vision.image_files import camera_of
from cairn.vision.images import decode, gray_of

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
"""The types of topics that hold images."""

# Images of a pair that was taken at once differ by less than this [ns].
_AT_ONCE = SECOND // 100


def image_topics(
    path: Path, types: Mapping[str, str], named: Mapping[str, str]
) -> tuple[list[str], list[str]]:
    """The topics of the left (or only) and of the right camera, with remarks.

    `types` are those of the bag's topics, `named` the topics named for left_image and right_image.
    There are none if the bag has no images, or it is not clear which to take. Raises
    `RecordingError` if a named one is none of images.
    """
    found = sorted(topic for topic, kind in types.items() if kind in IMAGES)
    given = [named[key] for key in ("left_image", "right_image") if key in named]
    for topic in given:
        if topic not in found:
            raise RecordingError(
                f"{path}: {topic} is no topic of images; there "
                f"{'are ' + ', '.join(found) if found else 'is none'}."
            )
    if given or len(found) <= 1:
        return given or found, []
    sides = {side: [t for t in found if _side(t) == side] for side in ("left", "right")}
    if all(len(topics) == 1 for topics in sides.values()):
        return [*sides["left"], *sides["right"]], []
    return [], [
        f"several topics hold images, so none is replayed: {', '.join(found)}; name one with the "
        "parameter topics.left_image, and a stereo camera's other with topics.right_image"
    ]


def bag_images(path: Path, topics: list[str]) -> tuple[Images, list[str]]:
    """The images of one topic, or the pairs of two, with remarks on what is left out.

    Raises `RecordingError` if they cannot be read.
    """
    notes: list[str] = []
    times = [_times(path, topic, notes) for topic in topics]
    chosen = [list(times[0])]
    if len(topics) == 2:
        chosen = _paired(*times)
        alone = sum(len(of) for of in times) - 2 * len(chosen[0])
        if alone:
            notes.append(f"{alone} images have no other of a pair, left out")
    if not chosen[0]:
        raise RecordingError(
            f"{path} holds no {'pairs of ' * (len(topics) == 2)}images on {' and '.join(topics)}"
            + (" taken at once (within 10 ms)." if len(topics) == 2 else ".")
        )
    height, width = _first_whole(_InOrder(path, topics[0], chosen[0]), len(chosen[0])).shape
    readers = [_InOrder(path, topic, of) for topic, of in zip(topics, chosen, strict=True)]

    def load(index: int) -> tuple[Gray, ...]:
        return tuple(reader.image(index) for reader in readers)

    stamps = [times[0][number] for number in chosen[0]]
    return Images(" and ".join(topics), stamps, len(topics), (width, height), load), notes


class _InOrder:
    """The images with given numbers of one topic; no earlier one than the last can be had."""

    def __init__(self, path: Path, topic: str, numbers: list[int]) -> None:
        self._name = f"{path}, topic {topic}"
        self._numbers = numbers
        self._messages = enumerate(_messages(path, topic))

    def image(self, index: int) -> Gray:
        for number, (_, message) in self._messages:
            if number == self._numbers[index]:
                return _gray(self._name, number, message)
        raise RecordingError(f"{self._name} ends before image {index + 1}")


def _first_whole(images: _InOrder, count: int) -> Gray:
    """The first image that is not damaged; raises `RecordingError` if there is none."""
    for index in range(count - 1):
        with suppress(RecordingError):
            return images.image(index)
    return images.image(count - 1)


def _messages(path: Path, topic: str) -> Iterator[tuple[int, Any]]:
    """The messages of a topic with their times of receipt [ns]."""
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            of = [c for c in reader.connections if "/" + c.topic.lstrip("/") == topic]
            for connection, got, raw in reader.messages(of):
                yield got, reader.deserialize(raw, connection.msgtype)
    except Exception as error:  # the library fails in any way on a broken bag
        raise RecordingError(
            f"{path}: its images cannot be read ({' '.join(str(error).split())}): mend the bag "
            "with `rosbag reindex`, `ros2 bag reindex` or `mcap recover`"
        ) from error


def _times(path: Path, topic: str, notes: list[str]) -> dict[int, int]:
    """The stamps [ns] of a topic's images by their numbers, in order; remarks on others."""
    received = [(got, message.header.stamp) for got, message in _messages(path, topic)]
    stamps, note = own_stamps(topic, received)
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
    """The numbers of left and of right images that were taken at once."""
    pairs: list[list[int]] = [[], []]
    others = deque(right.items())
    for number, stamp in left.items():
        while others and others[0][1] < stamp - _AT_ONCE:
            others.popleft()
        if others and others[0][1] <= stamp + _AT_ONCE:
            pairs[0].append(number)
            pairs[1].append(others.popleft()[0])
    return pairs


def _gray(name: str, number: int, message: Any) -> Gray:
    try:
        if hasattr(message, "format"):
            return decode(f"it ({message.format})", np.asarray(message.data, np.uint8).tobytes())
        return gray_of(
            Image(
                height=message.height,
                width=message.width,
                encoding=message.encoding,
                is_bigendian=message.is_bigendian,
                step=message.step,
                data=np.asarray(message.data, np.uint8).ravel(),
            )
        )
    except (CairnError, InvalidMessage) as error:
        raise RecordingError(f"{name}, image {number + 1}: {error}") from error


def _side(topic: str) -> str | None:
    """The camera that any part of a topic's name tells."""
    sides = {camera_of(Path(part)) for part in topic.strip("/").split("/")} - {None}
    return sides.pop() if len(sides) == 1 else None
