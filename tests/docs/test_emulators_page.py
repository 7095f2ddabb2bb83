"""What docs/drivers/emulators.md shows is true."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes


PAGE = "docs/drivers/emulators.md"


def test_transcript_equals_the_printed_output(
    page_blocks: Callable[[str], Any], tmp_path: Path
) -> None:
    (block,) = (block for block in page_blocks(PAGE) if block.language == "console")
    command, _, expected = block.text.removeprefix("$ ").partition("\n")
    words, piped = re.fullmatch(r"printf '(.*)' \| cairn (.*)", command).groups()[::-1]  # type: ignore[union-attr]
    done = subprocess.run(
        [str(Path(sys.executable).with_name("cairn")), *words.split()],
        input=piped.replace("\\n", "\n"),
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=True,
    )
    assert done.stdout == expected
