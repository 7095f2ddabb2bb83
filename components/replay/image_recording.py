"""Recordings of cameras alone: folders of images, and videos."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cairn import CairnError
from cairn.components.replay.image_folder import open_folder
from cairn.components.replay.recording import (
    Images,
    Odometry,
    RecordingError,
    Scans,
    Sightings,
    Source,
    Trajectory,
)
from cairn.components.replay.video import is_video, open_videos
from cairn.schemas.cairn_msgs import VisualMap
from cairn.vision.image_files import SUFFIXES, camera_of, is_camera_folder, pair_files


class ImageRecording:
    """The images of one camera or of a stereo pair.

    At `path` is a video, a folder of images, or a folder of a video of each camera. `rate_hz` is
    how many images a second holds, where nothing else tells.
    """

    def __init__(self, path: Path, rate_hz: float | None) -> None:
        """Look at all of them; raises `RecordingError`."""
        try:
            self._images, self._notes = _opened(path, rate_hz)
        except RecordingError:
            raise
        except CairnError as error:
            raise RecordingError(str(error)) from error

    def span(self) -> tuple[int, int]:
        """Times [ns] of the first and the last image."""
        return self._images.stamps[0], self._images.stamps[-1]

    def images(self) -> Images | None:
        """The images."""
        return self._images

    def odometry(self) -> Odometry | None:
        """None: there are images alone."""
        return None

    def scans(self) -> Scans | None:
        """None: there are images alone."""
        return None

    def sightings(self) -> Sightings | None:
        """None: there are images alone."""
        return None

    def truth(self) -> Trajectory | None:
        """None: there are images alone."""
        return None

    def surveyed(self) -> VisualMap | None:
        """None: there are images alone."""
        return None

    def sources(self) -> Sequence[Source]:
        """The cameras."""
        images = self._images
        kind = "image pair" if images.cameras == 2 else "image"
        width, height = images.size
        return [Source("images", images.name, f"{kind} {width} x {height}", len(images.stamps))]

    def notes(self) -> Sequence[str]:
        """What was left out."""
        return self._notes


def holds_images(folder: Path) -> bool:
    """Whether a folder is a recording of a camera: by its images, videos, folders of cameras."""
    for child in folder.iterdir():
        if child.suffix.lower() in SUFFIXES or (child.is_file() and is_video(child)):
            return True
        if is_camera_folder(child) or (child.is_dir() and camera_of(child / "x") is not None):
            return True
    return False


def _opened(path: Path, rate_hz: float | None) -> tuple[Images, list[str]]:
    if path.is_file():
        return open_videos([path], rate_hz)
    videos = [child for child in sorted(path.iterdir()) if child.is_file() and is_video(child)]
    if not videos:
        return open_folder(path, rate_hz)
    pairs = pair_files(
        (video for video in videos if camera_of(video) == "left"),
        (video for video in videos if camera_of(video) == "right"),
    ).pairs
    if len(videos) != 2 or not pairs:
        raise RecordingError(
            f"{path} holds the videos {', '.join(video.name for video in videos)}: name one of "
            "them, or leave two whose names differ by left and right alone"
        )
    return open_videos(pairs[0], rate_hz)
