"""Saves the map of a running component `slam` under a name of the user's."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cairn import CairnError
from cairn.client import Robot
from cairn.components.slam.graph_file import read_graph, write_graph
from cairn.components.slam.quality import MapQuality
from cairn.planar.grid import OccupancyCells
from cairn.planar.map_file import read_map, write_map
from cairn.system.files import replacing_together
from cairn.terminal.output import line, print_json
from cairn.tools.mapping.target import map_files
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
    """Raise `CairnError` if the map `out` cannot be written, or exists without `force`."""
    map_files(out, _ENDINGS, force=force)


def save_map(robot: Robot, out: Path, *, force: bool) -> SavedMap:
    """Have `slam` save its map, and copy it to OUT.yaml, OUT.pgm and OUT.graph.

    With recognized objects, also to the visual map OUT.cairn.

    Raises `CairnError` if nothing maps, if `slam` cannot save, if it runs on another computer, or
    as `check_target`.
    """
    files = map_files(out, _ENDINGS, force=force)
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
    target = files[".graph"]
    if target.exists() and target.samefile(graph_file):
        raise CairnError(f"{target} is the file that {slam} is writing to; give another name")
    with replacing_together(files) as parts:
        write_map(parts[".yaml"], grid)
        write_graph(parts[".graph"], mapper, f"saved from {slam}")
        if ".cairn" in sources:
            copy_map(sources[".cairn"], parts[".cairn"])
    written = tuple(file for file in files.values() if file.exists())
    return SavedMap(written, grid, dict(reply["quality"]))


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
    loops = f"  loops      {quality.loops} closed, {quality.loops_rejected} rejected"
    if quality.loops:
        loops += f"; they differ by {quality.loop_error_m:.3f} m, {quality.loop_error_deg:.2f} deg"
    on_walls = (
        f"  on walls   {100 * quality.on_walls:.0f} % of the measured points (good: above 95 %)"
    )
    return [loops, on_walls] if quality.on_walls else [loops]
