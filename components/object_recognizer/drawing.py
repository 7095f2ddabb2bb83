"""Draws the views of an object model, and the objects detected in an image."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cairn import CairnError
from cairn.system.files import explain_os_error, replacing
from cairn.vision.object_model import ObjectModel
from cairn.vision.recognition import Detection

_COLORS = ("tab:red", "tab:green", "tab:blue", "tab:orange", "tab:purple", "tab:cyan", "tab:pink")
_DPI = 100


def draw_views(model: ObjectModel, file: Path) -> None:
    """Draw the views of a model with their features; raise `CairnError` if writing fails."""
    count = len(model.views)
    figure = Figure(figsize=(5.0 * count, 5.0), layout="constrained")
    for number, (axes, view) in enumerate(
        zip(np.atleast_1d(figure.subplots(1, count)), model.views, strict=True)
    ):
        axes.imshow(view.picture, cmap="gray", vmin=0, vmax=255)
        points, radii = view.features.points, view.features.scales / 2
        axes.scatter(
            points[:, 0], points[:, 1], s=radii**2, facecolors="none", edgecolors="tab:red",
            linewidths=0.5,
        )  # fmt: skip
        axes.set_title(f"view {number}: {len(view.features)} features")
        axes.axis("off")
    figure.suptitle(model.name)
    _save(figure, file)


def draw_detections(
    gray: NDArray[np.uint8], detections: Sequence[Detection], labels: Sequence[str], file: Path
) -> None:
    """Draw an image with outline, matched features and label of each detection.

    Raises `CairnError` if the file cannot be written.
    """
    height, width = gray.shape
    scale = max(1.0, 600 / width)
    figure = Figure(figsize=(scale * width / _DPI, scale * height / _DPI))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(gray, cmap="gray", vmin=0, vmax=255)
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.axis("off")
    for number, (one, label) in enumerate(zip(detections, labels, strict=True)):
        _draw_detection(axes, one, label, _COLORS[number % len(_COLORS)])
    _save(figure, file)


def _draw_detection(axes: Axes, one: Detection, label: str, color: str) -> None:
    outline = np.vstack((one.corners, one.corners[:1]))
    axes.plot(outline[:, 0], outline[:, 1], color=color, linewidth=2)
    axes.scatter(one.image_points[:, 0], one.image_points[:, 1], s=6, color=color)
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    x, y = one.corners[one.corners[:, 1].argmin()]
    axes.text(
        float(np.clip(x, left, right)), float(np.clip(y, top + 12, bottom)), label,
        color="white", fontsize=9, va="bottom", clip_on=True,
        ha="left" if x < (left + right) / 2 else "right",
        bbox={"facecolor": color, "edgecolor": "none", "pad": 1.5, "alpha": 0.8},
    )  # fmt: skip


def _save(figure: Figure, file: Path) -> None:
    kind = file.suffix[1:].lower()
    if kind not in figure.canvas.get_supported_filetypes():
        raise CairnError(
            f"{file}: the suffix is not that of a supported image format; give a name that ends in "
            ".png"
        )
    try:
        # Without the software's name, equal pictures give equal bytes; only PNG has this field.
        metadata = {"Software": None} if kind == "png" else None
        with replacing(file) as part:
            figure.savefig(part, dpi=_DPI, metadata=metadata, format=kind)
    except OSError as error:
        raise CairnError(f"{file} cannot be written: {explain_os_error(error)}") from error
