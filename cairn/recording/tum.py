"""Trajectories in the format of the TUM RGB-D benchmark: `timestamp tx ty tz qx qy qz qw`.

Times are in seconds, positions in m, rotations are quaternions. evo, rpg_trajectory_evaluation and
other tools read it (cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats).
"""

from collections.abc import Iterable
from typing import Final

from cairn.system.clock import SECOND

TUM_HEADER: Final = "# timestamp tx ty tz qx qy qz qw\n"
"""The first line of a file."""


def stamp_text(stamp_ns: int) -> str:
    """Return a time as seconds with all its nine decimals, as it was recorded."""
    seconds, nanoseconds = divmod(stamp_ns, SECOND)
    return f"{seconds}.{nanoseconds:09d}"


def tum_line(stamp_ns: int, pose: Iterable[float]) -> str:
    """Return a line for a pose: x, y, z [m], and the quaternion x, y, z, w.

    Numbers have as many digits as are needed to read the same values again.
    """
    return f"{stamp_text(stamp_ns)} {' '.join(repr(float(one)) for one in pose)}\n"
