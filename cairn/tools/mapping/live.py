"""Saves the map of a running component `slam` under a name of the user's."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cairn import CairnError
from cairn.cli.output import line, print_json
from cairn.client import Robot
from cairn.components.map_builder.cli import prepare
from cairn.components.slam.graph_file import read_graph, write_graph
from cairn.components.slam.quality import MapQuality
from cairn.files import explain_os_error
from cairn.planar.grid import OccupancyCells
from cairn.planar.map_file import read_map, write_map
from cairn.visual_map.sqlite_file import copy_map

# Drawing a large map takes some seconds.
_SAVE_S = 60.0
_ENDINGS = (".yaml", ".pgm", ".graph", ".cairn")


@dataclass(frozen=True)
class SavedMap:
    """A saved map: its files, the grid map, and the figures of `slam` about it."""

    files: tuple[Path, ...]
    grid: OccupancyCells
    quality: dict[str, Any]


def check_target(out: Path, *, force: bool) -> None:
    """Raise `CairnError` if a file of the map `out` exists and `force` is not given."""
    existing = [file for file in _files(out) if file.exists()]
    if existing and not force:
        raise CairnError(
            f"{existing[0]} exists already. Give another name, or --force to replace it."
        )


def save_map(robot: Robot, out: Path, *, force: bool) -> SavedMap:
    """Have `slam` save its map, and copy it to OUT.yaml, OUT.pgm and OUT.graph.

    With recognized objects, also to the visual map OUT.cairn.

    Raises `CairnError` if nothing maps, if `slam` cannot save, if it runs on another computer, or
    as `check_target`.
    """
    check_target(out, force=force)
    slam = robot.component_of("slam")
    if slam is None:
        raise CairnError(
            "no component slam runs, which makes maps; start a deployment with one, such as "
            "`cairn up mapping`"
        )
    reply = robot.request(slam, "save", timeout_s=_SAVE_S)
    sources = {Path(file).suffix: Path(file) for file in reply["files"]}
    grid_file, graph_file = sources[".yaml"], sources[".graph"]
    elsewhere = CairnError(
        f"{slam} has saved the map on its own computer, as {', '.join(reply['files'])}; copy it "
        "from there"
    )
    if not (grid_file.exists() and graph_file.exists()):
        raise elsewhere
    grid, mapper = read_map(grid_file), read_graph(graph_file)
    if len(mapper.keyframes) < reply["keyframes"]:
        raise elsewhere
    yaml, image, graph, visual_map = files = _files(out)
    if graph.exists() and graph.samefile(graph_file):
        raise CairnError(f"{graph} is the file that {slam} is writing to; give another name")
    for file in files:
        prepare(file)
    write_map(yaml, grid)
    write_graph(graph, mapper, f"saved from {slam}")
    written = [yaml, image, graph]
    if ".cairn" in sources:
        copy_map(sources[".cairn"], visual_map)
        written.append(visual_map)
    else:
        remove(visual_map)
    return SavedMap(tuple(written), grid, dict(reply["quality"]))


def remove(*files: Path) -> None:
    """Remove files of an earlier map of the same name, which the new one does not have."""
    for file in files:
        try:
            file.unlink(missing_ok=True)
        except OSError as error:
            raise CairnError(f"{file} cannot be removed: {explain_os_error(error)}") from error


def print_saved(saved: SavedMap, *, as_json: bool) -> None:
    """Print what was written, and how good it is."""
    (width, height), quality = saved.grid.size_m, saved.quality
    if as_json:
        files = [str(file) for file in saved.files]
        print_json({"files": files, "width_m": width, "height_m": height, **quality})
        return
    line(
        f"{saved.files[0]}: {width:.1f} m x {height:.1f} m, cells of "
        f"{saved.grid.frame.resolution:g} m"
    )
    line(f"  scans      {quality['keyframes']} in the map")
    for text in quality_lines(MapQuality(**quality)):
        line(text)
    line(f"also written: {', '.join(file.name for file in saved.files[1:])}")


def quality_lines(quality: MapQuality) -> list[str]:
    """Return the figures of a grid map as lines to print."""
    return [
        f"  loops      {quality.loops} closed, {quality.loops_rejected} rejected; they differ by "
        f"{quality.loop_error_m:.3f} m, {quality.loop_error_deg:.2f} deg",
        f"  entropy    {quality.entropy_bit:.3f} bit per known cell",
        f"  conflicts  {100 * quality.conflicts:.0f} % of the cells that rays hit are free for "
        "most",
    ]


def _files(out: Path) -> tuple[Path, ...]:
    return tuple(out.with_name(out.name + ending) for ending in _ENDINGS)
