"""The page's modules without a browser: decoder of messages, geometry of the map, panels."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.browser.conftest import node
from tests.browser.messages import write

HERE = Path(__file__).parent
SAMPLES = 12  # of each message type


def test_decoder_agrees_with_cairn_and_with_foxglove(tmp_path: Path) -> None:
    program = node()
    for name in ("package.json", "package-lock.json", ".npmrc"):
        shutil.copy(HERE / name, tmp_path)
    installed = subprocess.run(
        ["npm", "ci", "--no-audit", "--no-fund"], cwd=tmp_path, capture_output=True, text=True
    )
    if installed.returncode:
        pytest.skip(f"npm cannot install the independent decoder: {installed.stderr[-500:]}")
    messages = tmp_path / "messages.jsonl"
    write(messages, SAMPLES)
    environment = {**os.environ, "MODULES": str(tmp_path), "MESSAGES": str(messages)}
    _run([program, "--test", str(HERE / "decoder.test.mjs")], environment)


def test_logic_of_the_panels() -> None:
    _run([node(), "--test", str(HERE / "panels.test.mjs")], dict(os.environ))


def test_zones_of_the_map() -> None:
    _run([node(), "--test", str(HERE / "zones.test.mjs")], dict(os.environ))


def test_geometry_of_the_map() -> None:
    _run([node(), "--test", str(HERE / "geometry.test.mjs")], dict(os.environ))


def _run(command: list[str], environment: dict[str, str]) -> None:
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
