"""Opens a recording of any format; formats are told apart by content, not by name."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from pathlib import Path

from cairn.components.replay.bag import BagRecording
from cairn.components.replay.carmen import CarmenRecording
from cairn.components.replay.carmen_lines import MESSAGES
from cairn.components.replay.image_recording import ImageRecording, holds_images
from cairn.components.replay.mrclam import MrclamRecording
from cairn.components.replay.recording import Recording, RecordingError
from cairn.components.replay.text_lines import text_lines
from cairn.components.replay.video import is_video

_KINDS = (
    "an MRCLAM folder (Barcodes.dat and Robot<n>_*.dat), a CARMEN log, a ROS 1 bag, "
    "the folder of a ROS 2 bag (with metadata.yaml), an MCAP file, a video, or a folder of images"
)
_BAGS = (b"#ROSBAG V", b"#ROSRECORD V", b"\x89MCAP0\r\n", b"SQLite format 3\x00")
# A CARMEN log may begin with comments and with hundreds of parameters.
_LINES_LOOKED_AT = 100


def open_recording(
    path: Path,
    robot: int | None = None,
    topics: Mapping[str, str] | None = None,
    scan_delay_s: float = 0.0,
    image_rate_hz: float | None = None,
) -> Recording:
    """The recording at `path`.

    `robot` is the number of one of an MRCLAM data set's robots. `topics` names a bag's topics for
    `scan`, `odom` and `truth`, where their types do not tell. `scan_delay_s` is by how much scans
    were stamped later than odometry of the same moment [s]. `image_rate_hz` is how many images or
    frames a second holds, where nothing else tells. Raises `RecordingError`.
    """
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return BagRecording(path, topics or {}, scan_delay_s)
        if next(path.glob("Barcodes.dat*"), None) or next(path.glob("Robot*_*.dat*"), None):
            if robot is None:
                raise RecordingError(
                    f"{path} is an MRCLAM data set of several robots: give `robot`, 1 to 5."
                )
            return MrclamRecording(path, robot)
        if holds_images(path):
            return ImageRecording(path, image_rate_hz)
        held = sorted(child.name for child in path.iterdir())[:8]
        raise RecordingError(
            f"{path} is no recording (it holds: {', '.join(held) or 'nothing'}). Give {_KINDS}."
        )
    if not path.exists():
        raise RecordingError(f"{path}: no such file or folder. Give {_KINDS}.")
    begins = _begins(path)
    if begins.startswith(_BAGS):
        return BagRecording(path, topics or {}, scan_delay_s)
    if is_video(path):
        return ImageRecording(path, image_rate_hz)
    if _is_carmen(path):
        return CarmenRecording(path, scan_delay_s)
    raise RecordingError(
        f"{path} is no recording that can be read (it begins with {begins[:16]!r}). Give {_KINDS}."
    )


def _begins(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            return stream.read(32)
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}.") from error


def _is_carmen(path: Path) -> bool:
    try:
        first = [text.split(maxsplit=1) for _, text in islice(text_lines(path), _LINES_LOOKED_AT)]
    except RecordingError as error:
        if "not a text file" in str(error):
            return False
        raise
    return any(words and words[0] in MESSAGES for words in first)
