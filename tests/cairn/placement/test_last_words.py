"""How a component's process ended is one sentence with its process and its log."""

from pathlib import Path

import pytest

from cairn.placement.last_words import closing_words, end_of
from cairn.supervision.child_process import ChildExit


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "base.log"


def test_killed(log: Path) -> None:
    log.write_text("INFO all is well\n")

    end = end_of(ChildExit(7, "base", None, 11), log)

    assert (end.normal, end.reason) == (False, f"was killed by SIGSEGV (process 7, log {log})")


def test_with_closing_words_of_its_own(log: Path) -> None:
    former, latter = closing_words(6, "former"), closing_words(7, "tick: ValueError:\nno device")
    log.write_text(f"{former}\nTraceback\n{latter}\nafterwards\n")

    failed = end_of(ChildExit(7, "base", 1, None), log)
    normal = end_of(ChildExit(6, "base", 0, None), log)

    assert failed.reason == f"failed (process 7, log {log}): tick: ValueError:; no device"
    assert (failed.normal, normal.normal, normal.reason) == (False, True, "former")


def test_without_closing_words_its_last_line_is_told(log: Path) -> None:
    log.write_text("Traceback\nRuntimeError: oh\n")

    end = end_of(ChildExit(7, "base", 1, None), log)

    assert end.reason == f"ended with exit code 1 (process 7, log {log}): RuntimeError: oh"


def test_without_a_log(log: Path) -> None:
    assert end_of(ChildExit(7, "base", 3, None), log).reason == (
        f"ended with exit code 3 (process 7, log {log})"
    )
    assert end_of(ChildExit(7, "base", 0, None), log).normal
