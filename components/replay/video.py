"""Videos as recorded cameras: one of a camera, or one each of left and right."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from cairn.components.replay.image_times import at_rate
from cairn.components.replay.recording import Gray, Images, RecordingError


def is_video(path: Path) -> bool:
    """Whether a file begins as AVI, MP4 (and QuickTime), Matroska (and WebM) or MPEG does."""
    try:
        with path.open("rb") as stream:
            begins = stream.read(12)
    except OSError:
        return False
    return (
        (begins[:4] == b"RIFF" and begins[8:12] == b"AVI ")
        or begins[4:8] in (b"ftyp", b"moov", b"mdat")
        or begins[:4] in (b"\x1aE\xdf\xa3", b"\x00\x00\x01\xba", b"\x00\x00\x01\xb3")
    )


def open_videos(files: Sequence[Path], rate_hz: float | None) -> tuple[Images, list[str]]:
    """The frames of one video, or of those of the left and the right camera, with remarks.

    Frames are taken at `rate_hz`, else at the video's own rate. Raises `RecordingError` if a file
    cannot be decoded, none tells its rate, or two are not of one size.
    """
    videos = [_Video(file) for file in files]
    first, last = videos[0], videos[-1]
    if first.size != last.size:
        raise RecordingError(
            f"{last.file} is {last.size[0]} x {last.size[1]} pixels, but {first.file} is "
            f"{first.size[0]} x {first.size[1]}: both cameras must have one size"
        )
    rate = rate_hz or first.rate
    if rate is None:
        raise RecordingError(f"{first.file} does not tell its rate: give image_rate_hz")
    notes = []
    count = min(video.frames for video in videos)
    if first.frames != last.frames:
        notes.append(
            f"{first.file.name} has {first.frames} frames, {last.file.name} {last.frames}: those "
            f"from number {count + 1} on are left out"
        )
    name = " and ".join(file.name for file in files)

    def load(index: int) -> tuple[Gray, ...]:
        return tuple(video.frame(index) for video in videos)

    return Images(name, at_rate(count, rate), len(videos), first.size, load), notes


class _Video:
    """One file; frames are decoded in order, as most of them build on those before."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self._capture = cv2.VideoCapture(str(file))
        self._next = 0
        if not self._capture.isOpened():
            raise RecordingError(
                f"{file} cannot be decoded: it is damaged, or of a codec that OpenCV was not built "
                "with; convert it, as with `ffmpeg -i IN -c:v mjpeg -q:v 3 OUT.avi`"
            )
        self.frames = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        self.size = (
            int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
            int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        )
        told = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.rate = told if math.isfinite(told) and 0.1 <= told <= 1000 else None
        if self.frames < 1:
            raise RecordingError(f"{file} holds no frames: take a fresh copy, or convert it")

    def frame(self, index: int) -> Gray:
        """Frame `index`, no earlier than the last one asked for; raises `RecordingError`."""
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
