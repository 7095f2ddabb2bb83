"""The deployment that replays a robot with a scanner: the commands in its head, and its map."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from cairn.planar.map_file import read_map
from tests.commands import cairn

ROOT = Path(__file__).parents[3]
MAP = Path("deploy/maps/fr079.yaml")
# Pixels on the edge of a ray, which other processors may round otherwise.
ROUNDED = 20


@pytest.mark.accuracy
def test_shipped_map_is_made_by_the_command_in_the_deployment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    head = (ROOT / "deploy" / "replay_carmen.yaml").read_text(encoding="utf-8")
    (command,) = re.findall(r"^# +cairn (map import .+)$", head, re.MULTILINE)
    shutil.copytree(ROOT / MAP.parent, tmp_path / MAP.parent)
    (tmp_path / "deploy" / "recordings").symlink_to(ROOT / "deploy" / "recordings")
    monkeypatch.chdir(tmp_path)

    answer = cairn(*command.split())

    assert (answer.code, answer.err) == (0, "")
    drawn, shipped = read_map(MAP), read_map(ROOT / MAP)
    assert drawn.frame == shipped.frame
    assert np.count_nonzero(drawn.values != shipped.values) <= ROUNDED
