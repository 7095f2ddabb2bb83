"""What docs/drivers/emulators.md shows is true."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from cairn.driver.emulator import Emulator
from cairn.driver.emulator_lines import TcpEnd
from cairn.driver.serial_and_tcp import TcpLink
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


def test_example_of_a_users_own_emulator_works(
    page_blocks: Callable[[str], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    titled = {block.title: block.text for block in page_blocks(PAGE) if block.title}
    code = titled["my_robot/thermometer.py"]
    (tmp_path / "my_robot").mkdir()
    (tmp_path / "my_robot" / "thermometer.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    thermometer = import_module("my_robot.thermometer")
    end = TcpEnd(0)
    with Emulator(thermometer.Thermometer(), end):
        link = TcpLink("127.0.0.1", end.port)
        link.write(b"T")
        assert link.read(LIMIT_S) == b"21.5\n"
        link.close()
    run = "import typer, my_robot.thermometer as it; typer.run(it.thermometer)"
    done = subprocess.run(
        [sys.executable, "-c", run, "--pty", "line"],
        input="heat\nquit\n",
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=True,
    )
    assert done.stdout.splitlines()[2:] == ["31.5 degrees"]
