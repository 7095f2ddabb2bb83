"""Opening a recording of any format; the format is found out by content, not by name."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from pathlib import Path

from cairn.components.replay_devices.bag_files import sqlite_files
from cairn.components.replay_devices.bounded_streams import first_lines
from cairn.components.replay_devices.carmen import CarmenRecording
from cairn.components.replay_devices.carmen_lines import MESSAGES
from cairn.components.replay_devices.image_recording import ImageRecording, holds_images, is_video
from cairn.components.replay_devices.mrclam import ROBOTS, MrclamRecording
from cairn.components.replay_devices.recording import Recording
from cairn.components.replay_devices.ros_bag import BagRecording
from cairn.errors import RecordingError
from cairn.limits.files import open_regular
from cairn.recording.mcap_file import holds_mcap
from cairn.system.files import explain_os_error

_FORMATS = (
    "an MRCLAM folder (Barcodes.dat and Robot<n>_*.dat), a CARMEN log, a ROS 1 bag, "
    "a ROS 2 bag (its folder, or a file *.db3), an MCAP file, a folder of MCAP files, "
    "a video, or a folder of images"
)
_BAGS = (b"#ROSBAG V", b"#ROSRECORD V", b"\x89MCAP0\r\n", b"SQLite format 3\x00")
# A CARMEN log may start with comments and with hundreds of parameters.
_LINES_READ = 100


def open_recording(
    path: Path,
    robot: int | None = None,
    topics: Mapping[str, str] | None = None,
    scan_delay_s: float = 0.0,
    image_rate_hz: float | None = None,
) -> Recording:
    """Open the recording at `path`.

    Args:
        path: file or folder of the recording.
        robot: number of one robot of an MRCLAM data set.
        topics: a bag's topics for `scan`, `odom`, `truth` and images, where their types are
            ambiguous.
        scan_delay_s: how much later scans were stamped than odometry of the same moment [s].
        image_rate_hz: images or frames per second, if the recording does not hold their times.

    Raises `RecordingError`.
    """
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return BagRecording(path, topics or {}, scan_delay_s)
        if next(path.glob("Barcodes.dat*"), None) or next(path.glob("Robot*_*.dat*"), None):
            if robot is None:
                held = [str(one) for one in ROBOTS if next(path.glob(f"Robot{one}_*.dat*"), None)]
                raise RecordingError(
                    f"{path} is an MRCLAM data set of several robots; choose one by --robot, in a "
                    f"deployment by the parameter `robot`; it has: {', '.join(held) or 'none'}."
                )
            return MrclamRecording(path, robot)
        if holds_mcap(path) or sqlite_files(path):
            return BagRecording(path, topics or {}, scan_delay_s)
        if holds_images(path):
            return ImageRecording(path, image_rate_hz)
        held = sorted(child.name for child in path.iterdir())[:8]
        raise RecordingError(
            f"{path} is not a recording (it holds: {', '.join(held) or 'nothing'}); use {_FORMATS}."
        )
    if not path.exists():
        raise RecordingError(f"{path}: no such file or folder; use {_FORMATS}.")
    start = _first_bytes(path)
    if not start:
        raise RecordingError(f"{path} is an empty file; record or copy it again.")
    if start.startswith(_BAGS):
        return BagRecording(path, topics or {}, scan_delay_s)
    if is_video(path):
        return ImageRecording(path, image_rate_hz)
    if _is_carmen(path):
        return CarmenRecording(path, scan_delay_s)
    raise RecordingError(
        f"{path} is not a recording that can be read (it starts with {start[:16]!r}); use "
        f"{_FORMATS}."
    )


def _first_bytes(path: Path) -> bytes:
    try:
        with open_regular(path) as stream:
            return stream.read(32)
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {explain_os_error(error)}.") from error


def _is_carmen(path: Path) -> bool:
    try:
        first = [text.split(maxsplit=1) for _, text in islice(first_lines(path), _LINES_READ)]
    except RecordingError as error:
        if "not a text file" in str(error):
            return False
        raise
    return any(words and words[0] in MESSAGES for words in first)
