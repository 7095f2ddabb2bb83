"""Recordings of cameras: folders of images and videos, of one camera or of a stereo camera."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from cairn import SECOND, CairnError
from cairn.components.replay_devices.bounded_streams import text_lines
from cairn.components.replay_devices.record_times import TimeQuality, time_quality
from cairn.components.replay_devices.recording import (
    Gray,
    ImageStream,
    RecordedTopic,
    Recording,
)
from cairn.errors import RecordingError
from cairn.limits.files import open_regular
from cairn.limits.images import check_pixels
from cairn.vision.image_files import (
    assign_cameras,
    camera_of,
    images_in,
    is_camera_folder,
    is_image,
    pair_files,
)
from cairn.vision.images import read_image, upright_size


class ImageRecording(Recording):
    """The images of one camera or of a stereo camera.

    At `path` is a video, a folder of images, or a folder with a video of each camera. `rate_hz` is
    the number of images per second, if the recording does not hold their times.
    """

    def __init__(self, path: Path, rate_hz: float | None) -> None:
        """Read times and sizes of all images; raises `RecordingError`."""
        try:
            self._images, self._notes = _open(path, rate_hz)
        except RecordingError:
            raise
        except CairnError as error:
            raise RecordingError(str(error)) from error

    def span(self) -> tuple[int, int]:
        """Return the times [ns] of the first and the last image."""
        return self._images.stamps[0], self._images.stamps[-1]

    def images(self) -> ImageStream | None:
        """Return the images."""
        return self._images

    def topics(self) -> Sequence[RecordedTopic]:
        """Return the cameras."""
        images = self._images
        kind = "image pair" if images.cameras == 2 else "image"
        width, height = images.size
        return [
            RecordedTopic("images", images.name, f"{kind} {width} x {height}", len(images.stamps))
        ]

    def time_quality(self) -> Mapping[str, TimeQuality]:
        """Return the quality of the images' times."""
        return {"images": time_quality(self._images.stamps)}

    def notes(self) -> Sequence[str]:
        """Return what was left out."""
        return self._notes


def holds_images(folder: Path) -> bool:
    """Return whether a folder holds images, videos, or folders of cameras."""
    for child in folder.iterdir():
        if is_image(child) or (child.is_file() and is_video(child)):
            return True
        if is_camera_folder(child) or (child.is_dir() and camera_of(child / "x") is not None):
            return True
    return False


def _open(path: Path, rate_hz: float | None) -> tuple[ImageStream, list[str]]:
    if path.is_file():
        return open_videos([path], rate_hz)
    videos = [child for child in sorted(path.iterdir()) if child.is_file() and is_video(child)]
    if not videos:
        return open_image_folder(path, rate_hz)
    pairs = pair_files(
        (video for video in videos if camera_of(video) == "left"),
        (video for video in videos if camera_of(video) == "right"),
    ).pairs
    if len(videos) != 2 or not pairs:
        raise RecordingError(
            f"{path} holds the videos {', '.join(video.name for video in videos)}: name one of "
            "them, or keep two whose names differ only by left and right"
        )
    return open_videos(pairs[0], rate_hz)


def open_image_folder(folder: Path, rate_hz: float | None) -> tuple[ImageStream, list[str]]:
    """Return the images of a folder in order, with notes on those left out.

    Images with left and right, or cam0 and cam1, in their names or their folders' names, are those
    of a stereo camera. Raises `CairnError` if there is none, one cannot be read, or sizes or times
    are inconsistent.
    """
    files = images_in(folder)
    sides = list(assign_cameras(files).values())
    notes = []
    columns: list[Sequence[Path]] = [files]
    if {"left", "right"} <= set(sides):
        paired = pair_files(
            (file for file, side in zip(files, sides, strict=True) if side == "left"),
            (file for file, side in zip(files, sides, strict=True) if side == "right"),
        )
        if not paired.pairs:
            raise RecordingError(
                f"{folder}: no left image has a right one: names of a pair may differ only "
                "by left and right, or by the number in cam0 and cam1"
            )
        columns = [[a for a, _ in paired.pairs], [b for _, b in paired.pairs]]
        unpaired = [
            *paired.unpaired,
            *(f for f, side in zip(files, sides, strict=True) if side is None),
        ]
        if unpaired:
            some = ", ".join(str(file.relative_to(folder)) for file in unpaired[:5])
            notes.append(f"{len(unpaired)} images have no partner, left out: {some}")
    size = _size([file for column in columns for file in column])

    rows = sorted(
        zip(image_stamps(folder, columns[0], rate_hz), *columns, strict=True),
        key=lambda row: row[0],
    )
    stamps = [row[0] for row in rows]
    check_order(folder, [row[1] for row in rows], stamps)

    def load(index: int) -> tuple[Gray, ...]:
        return tuple(read_image(file) for file in rows[index][1:])

    return ImageStream(folder.name, stamps, len(columns), size, load), notes


def _size(files: Sequence[Path]) -> tuple[int, int]:
    """Return the width and height [px] of all images, from their first bytes."""
    sizes = {file: upright_size(file) for file in files}
    first, size = next(iter(sizes.items()))
    for file, other in sizes.items():
        if other != size:
            raise RecordingError(
                f"{file} is {other[0]} x {other[1]} pixels, but {first} is {size[0]} x {size[1]}: "
                "all images of a camera need one size; put others into another folder"
            )
    return size


TIMES = "times.txt"
"""The file with the times of images: a line each, time [s] and optionally the name."""

# Images without recorded times start here, as a robot's clock is never at 0 [ns].
_FIRST = SECOND
# By their number of digits, integers are times since 1970 in milli-, micro-, nanoseconds.
_UNITS = {13: SECOND // 1000, 16: SECOND // 1_000_000, 19: 1}
_SECONDS = re.compile(r"[0-9]{10}\.[0-9]+")


def stamps_at_rate(count: int, rate_hz: float) -> list[int]:
    """Return times [ns] of `count` images at a constant rate."""
    return [_FIRST + round(index * SECOND / rate_hz) for index in range(count)]


def image_stamps(folder: Path, files: Sequence[Path], rate_hz: float | None) -> list[int]:
    """Return the times [ns] of a folder's images: by `times.txt`, their names, or `rate_hz`.

    Raises `RecordingError` if none of them is there, or a table without names is not in order.
    """
    table = folder / TIMES
    if table.is_file():
        return _by_table(table, files)
    named = [stamp for file in files if (stamp := _stamp_in_name(file)) is not None]
    if len(named) == len(files):
        return named
    if rate_hz is not None:
        return stamps_at_rate(len(files), rate_hz)
    raise RecordingError(
        f"{folder}: the times of its images are unknown: set image_rate_hz, or add a file "
        f"{TIMES} with a time [s] for each image, line by line; names such as {files[0].name} "
        "are not times since 1970"
    )


def check_order(folder: Path, files: Sequence[Path], stamps: Sequence[int]) -> None:
    """Raise `RecordingError` unless each of the files was taken after the one before it."""
    for (before, earlier), (file, later) in pairwise(zip(files, stamps, strict=True)):
        if later <= earlier:
            raise RecordingError(
                f"{folder}: {file.name} has time {later / SECOND:.6f} s, not after "
                f"{before.name} with {earlier / SECOND:.6f} s: correct their names or {TIMES}"
            )


def _by_table(table: Path, files: Sequence[Path]) -> list[int]:
    rows = []
    for number, text in text_lines(table):
        words = text.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        rows.append((_stamp(table, number, words[0]), words[1:]))
    if rows and all(rest for _, rest in rows):
        named = {Path(rest[0]).name: stamp for stamp, rest in rows}
        missing = [file.name for file in files if file.name not in named]
        if missing:
            raise RecordingError(
                f"{table} has no time for {missing[0]} ({len(missing)} of {len(files)} images "
                "lack one): add it, or remove the images"
            )
        return [named[file.name] for file in files]
    if len(rows) != len(files):
        raise RecordingError(
            f"{table} has {len(rows)} times, but there are {len(files)} images: write a line for "
            "each, or put the image's name behind the time"
        )
    stamps = [stamp for stamp, _ in rows]
    check_order(table.parent, files, stamps)
    return stamps


def _stamp(table: Path, number: int, word: str) -> int:
    if word.isdecimal() and len(word) in _UNITS:
        return int(word) * _UNITS[len(word)]
    try:
        seconds = float(word)
    except ValueError:
        seconds = math.nan
    if not 0 <= seconds < 1e11:
        raise RecordingError(f"{table}, line {number}: {word} is not a time in seconds")
    return round(seconds * 1e6) * 1000


def _stamp_in_name(file: Path) -> int | None:
    """Return the time since 1970 [ns] in a file's name; None if there is none."""
    seconds = _SECONDS.search(file.stem)
    if seconds is not None:
        whole, _, part = seconds[0].partition(".")
        return int(whole) * SECOND + int(part[:9].ljust(9, "0"))
    for digits in re.findall(r"[0-9]+", file.stem):
        if len(digits) in _UNITS:
            return int(digits) * _UNITS[len(digits)]
    return None


def is_video(path: Path) -> bool:
    """Return whether a file starts like AVI, MP4 (QuickTime), Matroska (WebM) or MPEG."""
    try:
        with open_regular(path) as stream:
            start = stream.read(12)
    except OSError:
        return False
    return (
        (start[:4] == b"RIFF" and start[8:12] == b"AVI ")
        or start[4:8] in (b"ftyp", b"moov", b"mdat")
        or start[:4] in (b"\x1aE\xdf\xa3", b"\x00\x00\x01\xba", b"\x00\x00\x01\xb3")
    )


def open_videos(files: Sequence[Path], rate_hz: float | None) -> tuple[ImageStream, list[str]]:
    """Return the frames of one video, or of a left and a right one, with notes.

    Their rate is `rate_hz`, else the video's own. Raises `RecordingError` if a file cannot be
    decoded, the rate is unknown, or two videos differ in size.
    """
    videos = [_Video(file) for file in files]
    first, last = videos[0], videos[-1]
    if first.size != last.size:
        raise RecordingError(
            f"{last.file} is {last.size[0]} x {last.size[1]} pixels, but {first.file} is "
            f"{first.size[0]} x {first.size[1]}: both cameras need one size"
        )
    rate = rate_hz or first.rate
    if rate is None:
        raise RecordingError(f"{first.file} does not hold its rate: set image_rate_hz")
    notes = []
    count = min(video.frames for video in videos)
    if first.frames != last.frames:
        notes.append(
            f"{first.file.name} has {first.frames} frames, {last.file.name} {last.frames}: frames "
            f"from number {count + 1} on are left out"
        )
    name = " and ".join(file.name for file in files)

    def load(index: int) -> tuple[Gray, ...]:
        return tuple(video.frame(index) for video in videos)

    return ImageStream(name, stamps_at_rate(count, rate), len(videos), first.size, load), notes


# 11 hours at 25 Hz. A header may claim any number, for which times would be made.
_MOST_FRAMES = 1_000_000


class _Video:
    """One file; frames are decoded in order, as most depend on earlier ones."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self._capture = cv2.VideoCapture(str(file))
        self._next = 0
        if not self._capture.isOpened():
            raise RecordingError(
                f"{file} cannot be decoded: it is damaged, or its codec is not part of this "
                "OpenCV; convert it, for example with `ffmpeg -i IN -c:v mjpeg -q:v 3 OUT.avi`"
            )
        self.frames = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        self.size = (
            int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
            int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        )
        try:
            check_pixels(str(file), *self.size)
        except CairnError as error:
            raise RecordingError(str(error)) from error
        fps = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.rate = fps if math.isfinite(fps) and 0.1 <= fps <= 1000 else None
        if self.frames < 1:
            raise RecordingError(f"{file} holds no frames: take a fresh copy, or convert it")
        if self.frames > _MOST_FRAMES:
            raise RecordingError(
                f"{file}: its header has {self.frames} frames, more than {_MOST_FRAMES}; split it, "
                "or convert it if it is damaged"
            )

    def frame(self, index: int) -> Gray:
        """Return frame `index`, not before the last one returned; raises `RecordingError`."""
        while self._next < index and self._capture.grab():
            self._next += 1
        read, pixels = self._capture.read()
        if self._next != index or not read:
            raise RecordingError(
                f"{self.file} ends after {self._next} of {self.frames} frames: it is cut off or "
                "damaged there"
            )
        self._next += 1
        if pixels.ndim == 3:
            pixels = cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)
        return np.asarray(pixels, np.uint8)
