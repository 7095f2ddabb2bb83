"""A folder of images as a recorded camera, or of left and right ones as a stereo camera."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cairn.components.replay.image_times import check_order, times_of
from cairn.components.replay.recording import Gray, Images, RecordingError
from cairn.vision.image_files import assign_cameras, images_in, pair_files
from cairn.vision.images import read_image, upright_size


def open_folder(folder: Path, rate_hz: float | None) -> tuple[Images, list[str]]:
    """The images of a folder in order, with remarks on those left out.

    Images with left and right, or cam0 and cam1, in their names or their folders' names, are a
    stereo camera's.
    Raises `CairnError` if there is none, one cannot be read, sizes or times are not as they must.
    """
    files = images_in(folder)
    sides = list(assign_cameras(files).values())
    notes = []
    columns: list[Sequence[Path]] = [files]
    if {"left", "right"} <= set(sides):
        of = pair_files(
            (file for file, side in zip(files, sides, strict=True) if side == "left"),
            (file for file, side in zip(files, sides, strict=True) if side == "right"),
        )
        if not of.pairs:
            raise RecordingError(
                f"{folder}: no left image belongs to a right one: names of a pair must be the "
                "same but for left and right, or the number in cam0 and cam1"
            )
        columns = [[a for a, _ in of.pairs], [b for _, b in of.pairs]]
        alone = [*of.unpaired, *(f for f, side in zip(files, sides, strict=True) if side is None)]
        if alone:
            some = ", ".join(str(file.relative_to(folder)) for file in alone[:5])
            notes.append(f"{len(alone)} images have no other of a pair, left out: {some}")
    size = _size([file for column in columns for file in column])

    rows = sorted(
        zip(times_of(folder, columns[0], rate_hz), *columns, strict=True), key=lambda row: row[0]
    )
    stamps = [row[0] for row in rows]
    check_order(folder, [row[1] for row in rows], stamps)

    def load(index: int) -> tuple[Gray, ...]:
        return tuple(read_image(file) for file in rows[index][1:])

    return Images(folder.name, stamps, len(columns), size, load), notes


def _size(files: Sequence[Path]) -> tuple[int, int]:
    """Width and height [px] that all have, by their first bytes alone."""
    sizes = {file: upright_size(file) for file in files}
    first, size = next(iter(sizes.items()))
    for file, other in sizes.items():
        if other != size:
            raise RecordingError(
                f"{file} is {other[0]} x {other[1]} pixels, but {first} is {size[0]} x {size[1]}: "
                "a camera's images are all of one size; put others into folders of their own"
            )
    return size
