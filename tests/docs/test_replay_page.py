"""The commands of docs/how-to/replay.md print what the page shows."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.commands import cairn

pytestmark = pytest.mark.slow


@pytest.mark.accuracy
def test_contents_of_the_shipped_recording_are_as_shown(
    root: Path, page_blocks: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(root)
    blocks = page_blocks("docs/how-to/replay.md")
    (shown,) = [block.text for block in blocks if block.language == "console"]
    command = shown.splitlines()[0]

    answer = cairn(*command.removeprefix("$ cairn ").split())

    assert f"{command}\n{answer.out}" == shown
