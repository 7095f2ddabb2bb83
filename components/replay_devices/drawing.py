"""The drawing of a recording: its scans, and its path by odometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cairn import SECOND
from cairn.components.replay_devices.recording import (
    OdometryStream,
    Recording,
    ScanStream,
    poses_at,
)
from cairn.errors import RecordingError
from cairn.planar.poses import Pose
from cairn.planar.scans import beams_of

Array = NDArray[np.float64]

_SINGLE_SCANS, _MAPPED_SCANS = 4, 400  # drawn separately, and together as a map
_COLORS = ("tab:blue", "tab:orange", "tab:green", "tab:red")
_AT_SCANNER: Pose = (0.0, 0.0, 0.0)


def rough_map(scans: ScanStream, odometry: OdometryStream, mount: Pose = _AT_SCANNER) -> Array:
    """Return points (n, 2) [m] that evenly chosen scans hit, in the frame of the odometry.

    The scanner is at `mount` on the robot.
    """
    points = [np.zeros((0, 2))]
    for number in _chosen(len(scans.stamps), _MAPPED_SCANS):
        stamp = scans.stamps[number]
        if odometry.stamps[0] <= stamp <= odometry.stamps[-1]:
            scan_points = beams_of(scans.messages[number], mount).points()
            points.append(_transform(scan_points, poses_at(odometry, [stamp])[0]))
    return np.concatenate(points)


def draw_recording(recording: Recording, title: str, file: Path) -> None:
    """Draw scans in the scanner's frame, and with odometry, scans and path in its frame.

    If the recording does not hold the scanner's mount, that is assumed at the robot's origin.
    """
    scans, odometry = recording.scans(), recording.odometry()
    if scans is None and odometry is None:
        raise RecordingError(
            f"{title} holds neither scans nor odometry: there is nothing to draw; view its "
            "images instead"
        )
    panels = (scans is not None) + (odometry is not None)
    figure = Figure(figsize=(7.5 * panels, 7.5), layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(1, panels)))
    if scans is not None:
        _draw_scans(axes[0], scans)
    if odometry is not None:
        mount = recording.mount()
        _draw_track(axes[-1], scans, odometry, _AT_SCANNER if mount is None else mount.pose)
    for panel in axes:
        panel.set_aspect("equal", adjustable="datalim")
        panel.set_xlabel("x [m]")
        panel.set_ylabel("y [m]")
        panel.grid(alpha=0.25)
        panel.legend(loc="best", fontsize=8)
    figure.suptitle(title)
    try:
        # Without the software's name and the date, the same recording gives the same file.
        figure.savefig(file, dpi=110, metadata={"Software": None} if file.suffix == ".png" else {})
    except (OSError, ValueError) as error:
        raise RecordingError(f"{file} cannot be written: {error}") from error


def _draw_scans(axes: Axes, scans: ScanStream) -> None:
    for number, color in zip(_chosen(len(scans.stamps), _SINGLE_SCANS), _COLORS, strict=False):
        points = beams_of(scans.messages[number], _AT_SCANNER).points()
        seconds = (scans.stamps[number] - scans.stamps[0]) / SECOND
        axes.plot(*points.T, ".", color=color, markersize=3, label=f"scan at {seconds:.1f} s")
    axes.plot(0, 0, marker=(3, 0, -90), color="black", markersize=10, label="the scanner")
    axes.set_title("Scans in the scanner's frame")


def _draw_track(
    axes: Axes, scans: ScanStream | None, odometry: OdometryStream, mount: Pose
) -> None:
    if scans is not None:
        axes.plot(*rough_map(scans, odometry, mount).T, ",", color="#505050", alpha=0.5)
    x, y, _ = odometry.poses.T
    axes.plot(x, y, color="tab:blue", linewidth=1.2, label="path by odometry")
    axes.plot(x[0], y[0], "o", color="tab:green", markersize=7, label="start")
    axes.plot(x[-1], y[-1], "s", color="tab:red", markersize=7, label="end")
    axes.set_title("By odometry: " + ("scans and path" if scans is not None else "path"))


def _chosen(count: int, most: int) -> list[int]:
    """Return at most `most` evenly spaced indices of a series, the first and last included."""
    return sorted({round(k) for k in np.linspace(0, count - 1, min(count, most)).tolist()})


def _transform(points: Array, pose: Array) -> Array:
    x, y, theta = pose
    cosine, sine = np.cos(theta), np.sin(theta)
    transformed: Array = points @ np.array([[cosine, sine], [-sine, cosine]]) + (x, y)
    return transformed
