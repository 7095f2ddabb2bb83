"""Draws the pictures of a report in a process of its own: the robot's never import Matplotlib."""

from __future__ import annotations

import base64
import json
import subprocess
import sys
from pathlib import Path
from typing import Final

from pydantic import TypeAdapter

from cairn.bus.codec import Codec
from cairn.components.run_outputs.run_record import RunRecord
from cairn.schemas.nav_msgs import OccupancyGrid
from cairn.system.extras import missing_library

Grids = tuple[OccupancyGrid, OccupancyGrid] | None
"""The first and the newest grid map."""

_LIMIT_S: Final = 45.0  # before the stop limit of the shipped deployments
_RECORD: Final = TypeAdapter(RunRecord)


def draw_pictures(record: RunRecord, grids: Grids, folder: Path) -> str:
    """Write map.png and reliability.png; return why they could not be drawn, "" if they were."""
    codec = Codec()
    encoded = [base64.b64encode(codec.encode(one)).decode() for one in grids or ()]
    drawn = {"record": _RECORD.dump_python(record, mode="json"), "grids": encoded}
    try:
        done = subprocess.run(
            [sys.executable, "-m", __name__, str(folder)],
            input=json.dumps(drawn), capture_output=True, text=True, timeout=_LIMIT_S, check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    return (done.stderr.strip() or "the process ended").splitlines()[-1] if done.returncode else ""


def main() -> None:
    """Draw what the standard input describes into the folder that is named."""
    try:
        from cairn.components.run_outputs.pictures import draw_map, draw_reliability
    except ModuleNotFoundError as error:
        missing = missing_library(error)
        if missing is None:
            raise
        sys.exit(f"{missing[0]} is not installed; {missing[1]}")
    given = json.load(sys.stdin)
    codec = Codec()
    grids = [codec.decode(OccupancyGrid, base64.b64decode(one)) for one in given["grids"]]
    record, folder = _RECORD.validate_python(given["record"]), Path(sys.argv[1])
    draw_map(record, (grids[0], grids[1]) if grids else None, folder / "map.png")
    draw_reliability(record, folder / "reliability.png")


if __name__ == "__main__":
    main()
