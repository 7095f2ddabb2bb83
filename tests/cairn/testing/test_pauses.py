"""Samples that the machine itself spoils are taken anew, and judged by nobody if all are."""

import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

pytestmark = pytest.mark.processes


# Samples for 0.3 s; says when it begins with each, and what came of them.
_SAMPLER = """
import threading
import pytest
from cairn.testing.pauses import undisturbed

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


def test_a_sample_that_a_pause_has_spoilt_is_taken_anew(sampler: "subprocess.Popen[str]") -> None:
    assert line(sampler) == "sampling"
    pause(sampler, 0.5)

    assert line(sampler) == "sampling"


def test_where_the_machine_is_always_away_the_test_is_skipped_with_the_reason(
    sampler: "subprocess.Popen[str]",
) -> None:
    for _ in range(3):
        assert line(sampler) == "sampling"
        pause(sampler, 0.5)

    told = line(sampler)

    assert told.startswith("this machine is too busy for what is judged in real time: it paused")
    assert told.endswith("in each of 3 samples; run the test on a quiet one")


def line(process: "subprocess.Popen[str]") -> str:
    """What it says next."""
    assert process.stdout is not None
    assert select.select([process.stdout], [], [], 60)[0], "it says nothing more"
    return process.stdout.readline().rstrip("\n")


def pause(process: "subprocess.Popen[str]", seconds: float) -> None:
    """Keep it from running, as a busy host does."""
    os.kill(process.pid, signal.SIGSTOP)
    select.select([], [], [], seconds)
    os.kill(process.pid, signal.SIGCONT)
