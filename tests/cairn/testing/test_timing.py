"""Samples during pauses of the computer are repeated; if all have pauses, the test is skipped."""

import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

pytestmark = pytest.mark.processes


# Samples for 0.3 s; prints the start of each sample, and the result.
_SAMPLER = """
import threading
import pytest
from cairn.testing.timing import undisturbed

def take():
    print("sampling", flush=True)
    threading.Event().wait(0.3)
    return "good"

try:
    print(undisturbed(take))
except pytest.skip.Exception as reason:
    print(reason)
"""


@pytest.fixture
def sampler() -> Iterator["subprocess.Popen[str]"]:
    """A process that takes samples."""
    command = [sys.executable, "-c", _SAMPLER]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        yield process
        process.kill()


def test_sample_with_a_pause_is_repeated(sampler: "subprocess.Popen[str]") -> None:
    assert line(sampler) == "sampling"
    pause(sampler, 0.5)

    assert line(sampler) == "sampling"


def test_computer_that_always_pauses_skips_the_test_with_the_reason(
    sampler: "subprocess.Popen[str]",
) -> None:
    for _ in range(3):
        assert line(sampler) == "sampling"
        pause(sampler, 0.5)

    reason = line(sampler)

    assert reason.startswith("this computer is too busy for tests in real time: it paused")
    assert "3 samples" in reason
    assert "idle computer" in reason


def line(process: "subprocess.Popen[str]") -> str:
    """Return its next line."""
    assert process.stdout is not None
    assert select.select([process.stdout], [], [], 60)[0], "it prints nothing more"
    return process.stdout.readline().rstrip("\n")


def pause(process: "subprocess.Popen[str]", seconds: float) -> None:
    """Suspend it, as a busy host does."""
    os.kill(process.pid, signal.SIGSTOP)
    select.select([], [], [], seconds)
    os.kill(process.pid, signal.SIGCONT)
