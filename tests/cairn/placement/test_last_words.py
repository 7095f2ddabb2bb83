"""How a component's process ended is one sentence with its process and its log."""

from pathlib import Path

import pytest

from cairn.placement.last_words import LastWords, closing_words
from cairn.supervision.child import ChildEnd
from cairn.supervision.child_process import WITHOUT_SUCCESS, ChildExit


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "base.log"


def test_killed(log: Path) -> None:
    words = LastWords(log)
    log.write_text("INFO all is well\n")

    end = words.end_of(ChildExit(7, "base", None, 11))

    assert (end.normal, end.reason) == (False, f"was killed by SIGSEGV (process 7, log {log})")


def test_with_closing_words_of_its_own(log: Path) -> None:
    words = LastWords(log)
    former, latter = closing_words(6, "former"), closing_words(7, "tick: ValueError:\nno device")
    log.write_text(f"{former}\nTraceback\n{latter}\nafterwards\n")

    failed = words.end_of(ChildExit(7, "base", 1, None))
    normal = words.end_of(ChildExit(6, "base", 0, None))

    assert failed.reason == f"failed (process 7, log {log}): tick: ValueError:; no device"
    assert (failed.normal, normal.normal, normal.reason) == (False, True, "former")


def test_without_closing_words_its_last_line_is_told(log: Path) -> None:
    words = LastWords(log)
    log.write_text("Traceback\nRuntimeError: oh\n")

    end = words.end_of(ChildExit(7, "base", 1, None))

    assert end.reason == f"ended with exit code 1 (process 7, log {log}): RuntimeError: oh"


def test_what_a_former_process_wrote_is_not_told(log: Path) -> None:
    log.write_text("RuntimeError: oh\n")
    words = LastWords(log)

    end = words.end_of(ChildExit(7, "base", 1, None))

    assert end.reason == f"ended with exit code 1 (process 7, log {log})"


def test_without_a_log(log: Path) -> None:
    words = LastWords(log)
    assert words.end_of(ChildExit(7, "base", 3, None)).reason == (
        f"ended with exit code 3 (process 7, log {log})"
    )
    assert words.end_of(ChildExit(7, "base", 0, None)).normal


def test_work_that_is_over_but_not_done_is_a_normal_end_without_success(log: Path) -> None:
    words = LastWords(log)
    log.write_text(closing_words(7, "2 of 3 goals were reached"))

    end = words.end_of(ChildExit(7, "base", WITHOUT_SUCCESS, None))

    assert end == ChildEnd(True, "2 of 3 goals were reached", success=False)
