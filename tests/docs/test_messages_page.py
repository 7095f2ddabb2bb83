"""What docs/how-to/messages.md shows is true."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.slow

PAGE = "docs/how-to/messages.md"
METADATA = "Metadata-Version: 2.1\nName: cleaner\nVersion: 1.0\n"
USE = """
import numpy as np
from cairn.runtime.ports import ports_of, services_of
from cleaner.brushes import BrushDriver, Brushes
from cleaner.clean_msgs.srv import CleanArea
from cleaner.status import HALF_TURN, Status
assert Brushes().name == "main" and ports_of(BrushDriver)["brushes"].interface is Brushes
assert services_of(Status)["enable"].interface.__name__ == "SetBool"
assert CleanArea.Request().area.points == () and HALF_TURN.target_yaw > 3
"""


@pytest.mark.accuracy
def test_commands_of_the_page_print_what_it_shows(
    page_blocks: Callable[[str], Any], shell: Callable[[Path, Path], Any], tmp_path: Path
) -> None:
    for block in page_blocks(PAGE):
        if block.title:
            file = tmp_path / block.title
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(block.text, encoding="utf-8")
    (tmp_path / "cleaner" / "__init__.py").touch()
    user = shell(tmp_path, tmp_path)

    consoles = [block.text for block in page_blocks(PAGE) if block.language == "console"]
    assert len(consoles) == 2
    for text in consoles:
        command, _, expected = text.removeprefix("$ cairn ").partition("\n")
        found = user.cairn(*shlex.split(command)).replace(f"{tmp_path}/", "")
        assert found == expected, command
        if " import " in command:
            _install(tmp_path, found)

    user.run(sys.executable, "-c", USE)


def _install(folder: Path, printed: str) -> None:
    """Install the package with the entry points that the command has printed."""
    lines = [line.strip() for line in printed.splitlines()]
    first = lines.index('[project.entry-points."cairn.messages"]')
    name, _, value = lines[first + 1].partition(" = ")
    metadata = folder / "cleaner-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(METADATA)
    points = f"[cairn.messages]\n{name} = {value.strip(chr(34))}\n"
    (metadata / "entry_points.txt").write_text(points)
