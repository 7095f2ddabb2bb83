"""From pixels to a repaired map: a stereo camera, the recognizer and navigation, in lockstep."""

import json
import math
import subprocess
from pathlib import Path

import pytest

from cairn.testing.launching import CAIRN
from tests.navigation.driving import DEPLOY, SIM
from tests.patience import LIMIT_S

pytestmark = pytest.mark.images


ROOM = DEPLOY / "worlds" / "room.yaml"
START = "{x: 3.5, y: 2.0, theta: 0.0}"
MISSION = "mission=[[5.5, 2.3, 0.2], [7.2, 2.2, 0.2], [5.9, 2.6, -0.1]]"
MOVED = "[{at: 7, move: object_7, to: {x: 9.0, y: 1.9, theta: 3.1416}}]"


@pytest.mark.accuracy
def test_object_moved_in_view_is_moved_in_the_map(tmp_path: Path) -> None:
    world = tmp_path / "room.yaml"
    text = ROOM.read_text().replace("textures/", f"{ROOM.parent}/textures/")
    world.write_text(text.replace("robot: {x: 1.0, y: 1.0, theta: 0.0}", f"robot: {START}"))

    done = subprocess.run(
        [
            *(CAIRN, "up", str(SIM), "--overlay", str(DEPLOY / "pixels.yaml")),
            *("--set", MISSION, "--set", f"start={START}", "--set", "finish=true"),
            *("--set", f"world={world}", "--set", f"components.world.parameters.events={MOVED}"),
            *("--set", "components.stereo_camera.parameters.rate=3"),
            # In lockstep computing takes no time; on a robot observations have this delay.
            *("--set", "components.stereo_camera.parameters.delay_s=0.2"),
            *("--lockstep", "--seed", "1", "--report", str(tmp_path / "out")),
        ],
        capture_output=True,
        text=True,
        timeout=2 * LIMIT_S,  # ten seconds of computing, and on a new computer kernels as well
    )

    assert done.returncode == 0, done
    repaired = tmp_path / "out" / "visual_map.cairn"
    shown = json.loads(
        subprocess.run(
            [CAIRN, "map", "show", str(repaired), "--history", "--json"],
            capture_output=True,
            check=True,
            timeout=LIMIT_S,
        ).stdout
    )
    changes = [(c["object_id"], c["kind"]) for c in shown["changes"] if c["kind"] != "imported"]
    assert (7, "removed") in changes
    assert [object_id for object_id, kind in changes if kind != "refined"] == [7, 7]
    [moved] = [o for o in shown["objects"] if o["object_id"] == 7]
    assert math.hypot(moved["x"] - 9.0, moved["y"] - 1.9) < 0.1
