"""The plot of a calibration: residuals, errors of the images, coverage by corners."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from cairn.system.files import explained, replacing
from cairn.vision.calibration import Calibration, StereoCalibration

_MOST_LABELS = 40


def plot_calibration(
    cameras: Mapping[str, Calibration], stereo: StereoCalibration | None, file: Path
) -> None:
    """Plot residuals, the error of each image and the coverage by corners of each camera, by name.

    For a stereo pair, also plot the error of each pair. Raises `CairnError` if the file cannot be
    written.
    """
    rows = len(cameras) + (stereo is not None)
    figure = Figure(figsize=(15.0, 4.6 * rows), layout="constrained")
    grid = figure.add_gridspec(rows, 3, width_ratios=(1.0, 1.4, 1.4))
    for row, (name, found) in enumerate(cameras.items()):
        _plot_residuals(figure.add_subplot(grid[row, 0]), name, found)
        _plot_errors(figure.add_subplot(grid[row, 1]), found.errors, found.rms, found.outlying)
        _plot_coverage(figure.add_subplot(grid[row, 2]), found)
    if stereo is not None:
        axes = figure.add_subplot(grid[-1, :])
        _plot_errors(axes, stereo.errors, stereo.rms, ())
        axes.set_title(f"error of each pair, by its left image: rms {stereo.rms:.3f} px")
    with explained(f"{file}: the plot cannot be written"), replacing(file) as part:
        figure.savefig(part, dpi=100, format=file.suffix.lstrip(".") or "png")


def _plot_residuals(axes: Axes, name: str, found: Calibration) -> None:
    of = np.concatenate(list(found.residuals.values()))
    axes.scatter(of[:, 0], of[:, 1], s=4, alpha=0.5)
    # The limit ignores a few outliers, which would shrink the rest to a dot.
    reach = 1.2 * float(np.percentile(np.abs(of), 99.5))
    axes.add_patch(Circle((0.0, 0.0), found.rms, fill=False, color="black", linestyle="--"))
    axes.axhline(0.0, color="gray", linewidth=0.5)
    axes.axvline(0.0, color="gray", linewidth=0.5)
    axes.set_xlim(-reach, reach)
    axes.set_ylim(reach, -reach)
    axes.set_aspect("equal")
    axes.set_xlabel("right [px]")
    axes.set_ylabel("down [px]")
    axes.set_title(f"{name}: residuals, rms {found.rms:.3f} px")


def _plot_errors(
    axes: Axes, errors: Mapping[str, float], rms: float, outlying: Collection[str]
) -> None:
    positions = range(len(errors))
    colors = ["tab:orange" if key in outlying else "tab:blue" for key in errors]
    axes.bar(positions, list(errors.values()), color=colors)
    axes.axhline(rms, color="black", linewidth=0.8, linestyle="--")
    labels = [Path(key).stem for key in errors]
    if len(labels) <= _MOST_LABELS:
        axes.set_xticks(positions, labels, rotation=90, fontsize=8)
    axes.set_ylabel("rms [px]")
    axes.set_title("error of each image" + (" (outlying: orange)" if outlying else ""))


def _plot_coverage(axes: Axes, found: Calibration) -> None:
    corners = np.concatenate(list(found.corners.values()))
    off = np.linalg.norm(np.concatenate(list(found.residuals.values())), axis=1)
    most = float(np.percentile(off, 99.5))
    dots = axes.scatter(corners[:, 0], corners[:, 1], c=off, s=6, cmap="viridis", vmin=0, vmax=most)
    axes.figure.colorbar(dots, ax=axes, label="residual [px]")
    width, height = found.size
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_aspect("equal")
    wide, high = found.coverage
    axes.set_title(
        f"corners over {100 * wide:.0f} % of the width, {100 * high:.0f} % of the height"
    )
