"""Draws a recording: some of its scans, and a rough map of all by odometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cairn import SECOND
from cairn.components.replay.recording import Odometry, Recording, RecordingError, Scans
from cairn.planar.poses import Pose
from cairn.planar.scans import beams_of

Array = NDArray[np.float64]

_ALONE, _MAPPED = 4, 400  # how many scans are drawn each for itself, and in the map
_COLORS = ("tab:blue", "tab:orange", "tab:green", "tab:red")
_AT_SCANNER: Pose = (0.0, 0.0, 0.0)


def rough_map(scans: Scans, odometry: Odometry) -> Array:
    """Points (n, 2) [m] that evenly chosen scans hit, in the odometry's frame."""
    places = [np.zeros((0, 2))]
    for number in _chosen(len(scans.stamps), _MAPPED):
        stamp = scans.stamps[number]
        if odometry.stamps[0] <= stamp <= odometry.stamps[-1]:
            points = beams_of(scans.messages[number], _AT_SCANNER).points()
            places.append(_placed(points, _pose_at(odometry, stamp)))
    return np.concatenate(places)


def draw_recording(recording: Recording, title: str, file: Path) -> None:
    """Scans in the scanner's frame, and if there is odometry, scans and track in its frame.

    The scanner is taken to sit at the robot's origin: a recording does not say where it sits.
    """
    scans, odometry = recording.scans(), recording.odometry()
    if scans is None and odometry is None:
        raise RecordingError(
            f"{title} holds neither scans nor odometry: there is nothing to draw; look at its "
            "images themselves"
        )
    panels = (scans is not None) + (odometry is not None)
    figure = Figure(figsize=(7.5 * panels, 7.5), layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(1, panels)))
    if scans is not None:
        _draw_scans(axes[0], scans)
    if odometry is not None:
        _draw_track(axes[-1], scans, odometry)
    for one in axes:
        one.set_aspect("equal", adjustable="datalim")
        one.set_xlabel("x [m]")
        one.set_ylabel("y [m]")
        one.grid(alpha=0.25)
        one.legend(loc="best", fontsize=8)
    figure.suptitle(title)
    try:
        # Without the software's name and the date, the same recording gives the same bytes.
        figure.savefig(file, dpi=110, metadata={"Software": None} if file.suffix == ".png" else {})
    except (OSError, ValueError) as error:
        raise RecordingError(f"{file} cannot be written: {error}") from error


def _draw_scans(axes: Axes, scans: Scans) -> None:
    for number, color in zip(_chosen(len(scans.stamps), _ALONE), _COLORS, strict=False):
        points = beams_of(scans.messages[number], _AT_SCANNER).points()
        seconds = (scans.stamps[number] - scans.stamps[0]) / SECOND
        axes.plot(*points.T, ".", color=color, markersize=3, label=f"scan at {seconds:.1f} s")
    axes.plot(0, 0, marker=(3, 0, -90), color="black", markersize=10, label="the scanner")
    axes.set_title("Scans in the scanner's frame")


def _draw_track(axes: Axes, scans: Scans | None, odometry: Odometry) -> None:
    if scans is not None:
        axes.plot(*rough_map(scans, odometry).T, ",", color="#505050", alpha=0.5)
    x, y, _ = odometry.poses.T
    axes.plot(x, y, color="tab:blue", linewidth=1.2, label="way by odometry")
    axes.plot(x[0], y[0], "o", color="tab:green", markersize=7, label="begin")
    axes.plot(x[-1], y[-1], "s", color="tab:red", markersize=7, label="end")
    axes.set_title("As odometry has it" + (": scans and the way" if scans is not None else ""))


def _chosen(count: int, most: int) -> list[int]:
    """At most so many of a series, evenly: the first and the last are among them."""
    return sorted({round(k) for k in np.linspace(0, count - 1, min(count, most)).tolist()})


def _pose_at(odometry: Odometry, stamp: int) -> Array:
    """The pose at a time between records; the heading may be beyond a half turn."""
    after = min(max(int(np.searchsorted(odometry.stamps, stamp)), 1), len(odometry.stamps) - 1)
    pair = [after - 1, after] if after else [0, 0]
    poses = odometry.poses[pair]
    poses[:, 2] = np.unwrap(poses[:, 2])
    first, last = (odometry.stamps[k] for k in pair)
    share = (stamp - first) / (last - first) if last > first else 0.0
    pose: Array = poses[0] + share * (poses[1] - poses[0])
    return pose


def _placed(points: Array, pose: Array) -> Array:
    x, y, theta = pose
    cosine, sine = np.cos(theta), np.sin(theta)
    placed: Array = points @ np.array([[cosine, sine], [-sine, cosine]]) + (x, y)
    return placed
