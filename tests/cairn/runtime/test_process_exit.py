"""How a process ends: its exit code while threads run, and the report read from its log."""

import subprocess
import sys
from pathlib import Path

import pytest

from cairn.runtime.process_exit import WORK_NOT_DONE, ExitLog, ExitReport
from tests.patience import LIMIT_S
from tests.wording import assert_words

# A thread is within Zenoh, and messages come to it: Python's own end aborts the process here.
_BUSY = """
import atexit, sys, threading
import zenoh
from cairn.bus.session import open_router
from cairn.runtime.process_exit import end_process
from cairn.testing.launching import new_socket

session = open_router(new_socket())
publisher = session.declare_publisher("busy")
received = threading.Event()
subscriber = session.declare_subscriber("busy", zenoh.handlers.RingChannel(3))

def receive():
    while True:
        subscriber.handler.recv()
        received.set()

def send():
    while True:
        publisher.put(b"x")

for work in (receive, send):
    threading.Thread(target=work, daemon=True).start()
assert received.wait(100)
atexit.register(lambda: print("printed at exit"))
print("printed first,", end=" ")
end_process(3)
"""


@pytest.mark.processes
def test_threads_within_zenoh_do_not_turn_the_exit_code_into_an_abort() -> None:
    ended = subprocess.run(
        [sys.executable, "-c", _BUSY], capture_output=True, text=True, timeout=LIMIT_S, check=False
    )

    assert (ended.returncode, ended.stderr) == (3, "")
    assert ended.stdout == "printed first, printed at exit\n"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "base.log"


def report(log: ExitLog, code: int) -> ExitReport:
    """Return the report on process 7 for this exit code, -N for signal N."""
    return log.report(7, code)


def test_killed_process_is_reported_with_its_signal_and_log(file: Path) -> None:
    log = ExitLog(file)
    file.write_text("INFO all is well\n")

    end = report(log, -11)

    assert not end.normal
    assert_words(end.reason, "SIGSEGV", "process 7", str(file))


def test_reason_logged_by_a_process_is_reported(file: Path) -> None:
    log = ExitLog(file)
    file.write_text(
        "process 6 ended: earlier\nTraceback\n"
        "process 7 ended: tick: ValueError:; no device\nafterwards\n"
    )

    failed, normal = report(log, 1), report(log, 0)

    reason = "tick: ValueError:; no device"
    assert failed == ExitReport(False, f"{reason} (process 7, log {file})")
    assert normal == ExitReport(True, reason)


@pytest.mark.processes
def test_process_logs_its_reason_in_one_line(file: Path) -> None:
    log = ExitLog(file)
    program = (
        "from cairn.runtime.process_exit import log_reason; "
        "log_reason('tick: ValueError:\\nno device')"
    )
    with (
        file.open("w") as stderr,
        subprocess.Popen([sys.executable, "-c", program], stderr=stderr) as process,
    ):
        process.wait(LIMIT_S)

    assert log.report(process.pid, 0).reason == "tick: ValueError:; no device"


def test_without_a_logged_reason_the_last_line_is_reported(file: Path) -> None:
    log = ExitLog(file)
    file.write_text("Traceback\nRuntimeError: oh\n")

    expected = f"exit code 1: RuntimeError: oh (process 7, log {file})"
    assert report(log, 1).reason == expected


def test_lines_of_an_earlier_process_are_not_reported(file: Path) -> None:
    file.write_text("RuntimeError: oh\n")
    log = ExitLog(file)

    assert_words(report(log, 1).reason, "exit code 1", "process 7", str(file))


def test_process_without_a_log_is_reported(file: Path) -> None:
    log = ExitLog(file)
    assert_words(report(log, 3).reason, "exit code 3", "process 7", str(file))
    assert report(log, 0).normal


def test_exit_code_for_work_not_done_is_a_normal_end_without_success(file: Path) -> None:
    log = ExitLog(file)
    file.write_text("process 7 ended: 2 of 3 goals were reached")

    end = report(log, WORK_NOT_DONE)

    assert end == ExitReport(True, "2 of 3 goals were reached", success=False)
    assert end.exit_code == WORK_NOT_DONE


def rotate(file: Path) -> None:
    file.rename(f"{file}.1")
    file.touch()


def test_reason_is_found_in_a_log_that_was_rotated_just_before_or_after_it(file: Path) -> None:
    file.write_text("process 7 ended: of an earlier process with this number\n" * 1000)
    log = ExitLog(file)
    rotate(file)
    assert_words(report(log, 1).reason, "exit code 1")
    file.write_text("RuntimeError: oh\nprocess 7 ended: no device\n")
    assert report(log, 0).reason == "no device"
    rotate(file)
    assert report(log, 0).reason == "no device"
    file.write_text("printed at exit\n")
    assert report(log, 0).reason == "no device"


def test_stacks_are_found_in_a_log_that_was_rotated_meanwhile(file: Path) -> None:
    file.write_text("earlier stacks\n")
    log = ExitLog(file)
    end = log.end()
    assert not log.has_since(end, b"stacks")
    rotate(file)
    assert not log.has_since(end, b"stacks")
    file.write_text("later stacks\n")
    assert log.has_since(end, b"stacks")
