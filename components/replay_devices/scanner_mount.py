"""The mount of a bag's scanner: from its static transforms, or from a robot's description (URDF).

Static transforms are on `/tf_static`, and in ROS 1 also, published over and over, on `/tf`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cairn.components.replay_devices.recording import ScannerMount
from cairn.errors import RecordingError
from cairn.tf import InvalidArgumentError, RobotDescriptionError, Transform, read_urdf

Array = NDArray[np.float64]

BASES = ("base_footprint", "base_link")
"""Frames of a robot's base, the preferred one first: REP 105 and REP 120."""

_TILTED_RAD = math.radians(15.0)  # a scanner tilted by more does not scan the plane
_STILL_M, _STILL_RAD = 1e-3, 1e-3  # a transform that varies by more is not static
_MOST_FRAMES = 10_000


@dataclass(frozen=True)
class FrameLink:
    """A fixed transform (4, 4) from frame `child` to frame `parent`; `source` says where it is."""

    parent: str
    child: str
    matrix: Array
    source: str


def links_of_transforms(source: str, transforms: Iterable[Any]) -> list[FrameLink]:
    """Return the links of transforms (geometry_msgs/TransformStamped) that do not vary."""
    links: dict[tuple[str, str], FrameLink] = {}
    varying: set[tuple[str, str]] = set()
    last: dict[tuple[str, str], Transform] = {}
    for message in transforms:
        key = (message.header.frame_id.strip("/"), message.child_frame_id.strip("/"))
        if key in varying:
            continue
        try:
            transform = Transform.from_message(message.transform)
        except InvalidArgumentError:
            continue
        if last.get(key) == transform:
            continue
        last[key] = transform
        if key not in links:
            if len(links) < _MOST_FRAMES:
                links[key] = FrameLink(*key, transform.matrix(), source)
        elif not _same(links[key].matrix, transform.matrix()):
            varying.add(key)
    return [link for key, link in links.items() if key not in varying]


def links_of_description(source: str, urdf: str) -> list[FrameLink]:
    """Return the links of the fixed joints in a robot's description; raise `RecordingError`."""
    try:
        joints = read_urdf(urdf, source).joints
    except RobotDescriptionError as error:
        raise RecordingError(f"{error}; or name the scanner's mount yourself") from error
    return [
        FrameLink(joint.parent.strip("/"), joint.child.strip("/"), joint.transform.matrix(), source)
        for joint in joints
        if joint.is_fixed
    ]


def find_mount(
    links: Sequence[FrameLink],
    described: Callable[[], Sequence[FrameLink]],
    scanner: str,
    moved: Iterable[str],
) -> ScannerMount | str | None:
    """Return the mount of the frame `scanner` by links of transforms, else also by `described`.

    It is on the first of the frames `moved`, which odometry moves, or of `BASES`. Returns a
    sentence or None as `mount_of`.
    """
    bases = [name for name in dict.fromkeys((*(one.strip("/") for one in moved), *BASES)) if name]
    found = mount_of(links, scanner, bases)
    return mount_of([*links, *described()], scanner, bases) if found is None else found


def mount_of(
    links: Sequence[FrameLink], scanner: str, bases: Sequence[str]
) -> ScannerMount | str | None:
    """Return the mount of the frame `scanner` on the first of `bases` that it is linked to.

    Returns a sentence if the scanner is tilted, so that it has no pose in the plane; None if the
    links do not lead from a base to it.
    """
    for base in bases:
        chain = _chain(links, base, scanner.strip("/"))
        if chain is None:
            continue
        matrix = np.eye(4)
        for step, _ in chain:
            matrix = matrix @ step
        upright = float(matrix[2, 2])
        if abs(upright) < math.cos(_TILTED_RAD):
            tilt = math.degrees(math.acos(max(-1.0, min(1.0, upright))))
            return (
                f"the scanner's frame {scanner} is tilted by {tilt:.0f} degrees on {base}, so its "
                "scans are not in the plane; give its mount yourself if that is wrong"
            )
        yaw = math.atan2(matrix[1, 0], matrix[0, 0])
        pose = (round(float(matrix[0, 3]), 6), round(float(matrix[1, 3]), 6), round(yaw, 6))
        sources = " and ".join(dict.fromkeys(source for _, source in chain))
        return ScannerMount(pose, upright < 0, base, sources or f"frame {scanner}")
    return None


def _chain(links: Sequence[FrameLink], base: str, scanner: str) -> list[tuple[Array, str]] | None:
    """Return the transforms from frame `scanner` to `base`, in the order of their product."""
    links = links[:_MOST_FRAMES]
    neighbors: dict[str, list[tuple[str, FrameLink]]] = {}
    for link in links:
        neighbors.setdefault(link.parent, []).append((link.child, link))
        neighbors.setdefault(link.child, []).append((link.parent, link))
    came: dict[str, tuple[str, FrameLink] | None] = {base: None}
    waiting = deque([base])
    while waiting and scanner not in came:
        frame = waiting.popleft()
        for other, link in neighbors.get(frame, []):
            if other not in came:
                came[other] = (frame, link)
                waiting.append(other)
    if scanner not in came:
        return None
    chain: list[tuple[Array, str]] = []
    frame = scanner
    while (step := came[frame]) is not None:
        link = step[1]
        matrix = link.matrix if link.child == frame else np.linalg.inv(link.matrix)
        chain.append((matrix.astype(np.float64), link.source))
        frame = step[0]
    return chain[::-1]


def _same(first: Array, second: Array) -> bool:
    off = np.abs(first - second)
    return bool(off[:3, 3].max() < _STILL_M and off[:3, :3].max() < _STILL_RAD)
