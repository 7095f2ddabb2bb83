"""Make the plugins of outside/ importable, and write deployment files."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from textwrap import dedent

import pytest

Write = Callable[..., Path]


@pytest.fixture(scope="session", autouse=True)
def acme_robot() -> Iterator[None]:
    """The distribution acme-robot, as if installed."""
    outside = str(Path(__file__).parent / "outside")
    sys.path.append(outside)
    yield
    sys.path.remove(outside)


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """Write a YAML file below the current folder and return its relative path."""
    monkeypatch.chdir(tmp_path)

    def write_file(text: str, name: str = "robot.yaml") -> Path:
        path = Path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(dedent(text).lstrip("\n"), encoding="utf-8")
        return path

    return write_file
