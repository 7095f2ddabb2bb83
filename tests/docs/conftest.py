"""Runs commands as a user of the documentation types them."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from cairn.testing.launching import new_endpoint
from tests.patience import LIMIT_S

ROOT = Path(__file__).parents[2]
CAIRN = Path(sys.executable).with_name("cairn")


@dataclass(frozen=True)
class Shell:
    """A folder to stand in, and where Python finds packages beside those installed."""

    folder: Path
    python_path: Path

    def run(self, *words: str, status: int = 0) -> str:
        """What a command prints, which has to end with that exit status."""
        done = subprocess.run(
            words,
            cwd=self.folder,
            env=self.environment(),
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
        assert done.returncode == status, done.stdout + done.stderr
        return done.stdout if status == 0 else done.stderr

    def cairn(self, *words: str, status: int = 0) -> str:
        """What `cairn WORDS` prints."""
        return self.run(str(CAIRN), *words, status=status)

    def environment(self) -> dict[str, str]:
        return os.environ | {"PYTHONPATH": str(self.python_path), "COLUMNS": "200"}


@dataclass(frozen=True)
class Block:
    """A block of code in a page: its language, the file it is said to be of, its text."""

    language: str
    title: str
    text: str


def blocks(page: str) -> list[Block]:
    text = (ROOT / page).read_text(encoding="utf-8")
    fence = r'^```(\w+)(?: title="(\S+)")?\n(.*?)^```'
    found = re.findall(fence, text, re.DOTALL | re.MULTILINE)
    return [Block(*parts) for parts in found]


@pytest.fixture
def root() -> Path:
    return ROOT


@pytest.fixture
def shell() -> Callable[[Path, Path], Shell]:
    return Shell


@pytest.fixture(scope="session")
def page_blocks() -> Callable[[str], list[Block]]:
    return blocks


@pytest.fixture
def endpoint() -> str:
    """An endpoint on which no process listens."""
    return new_endpoint()
