"""What a test in real time concludes while the computer pauses, and of messages in transit."""

import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from functools import partialmethod
from typing import Any

import pytest

from cairn.testing.timing import Pauses, falls_silent, in_time

pytestmark = pytest.mark.processes


# Prints the start of each sample, samples until a line is written to it, and prints the result.
_SAMPLER = """
import sys
import pytest
from cairn.testing.timing import undisturbed

def take():
    print("sampling", flush=True)
    sys.stdin.readline()
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
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        yield process
        process.kill()


def test_sample_with_a_pause_is_repeated(sampler: "subprocess.Popen[str]") -> None:
    assert line(sampler) == "sampling"
    pause(sampler, 1.0)
    end_sample(sampler)

    assert line(sampler) == "sampling"


@pytest.mark.accuracy
def test_computer_that_always_pauses_skips_the_test_with_the_reason(
    sampler: "subprocess.Popen[str]",
) -> None:
    for _ in range(3):
        assert line(sampler) == "sampling"
        pause(sampler, 1.0)
        end_sample(sampler)

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


def end_sample(process: "subprocess.Popen[str]") -> None:
    assert process.stdin is not None
    print(file=process.stdin, flush=True)


class ScriptedReading:
    """Is silent or not in each window of time, as given; messages in transit arrive before."""

    def __init__(self, *silent: bool) -> None:
        self._silent = iter(silent)

    def await_silence(self, seconds: float, limit_s: float) -> None: ...

    def stays_silent(self, seconds: float) -> bool:
        return next(self._silent)


@pytest.mark.parametrize(
    ("silent", "falls"),
    [
        ([True], True),
        ([False, True], True),  # the message was delayed
        ([False, False, False], False),
    ],
)
def test_message_that_was_delayed_does_not_break_the_silence(
    silent: list[bool], falls: bool
) -> None:
    reading: Any = ScriptedReading(*silent)

    assert falls_silent(reading, 0.5) is falls


def test_late_event_counts_only_if_the_computer_did_not_pause(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for lost_s, reason in ((0.0, ""), (1e6, "this computer is too busy")):
        monkeypatch.setattr(Pauses, "_nap", partialmethod(lose, lost_s))
        assert in_time(lambda: True)
        if reason:
            with pytest.raises(pytest.skip.Exception, match=reason):
                in_time(lambda: False)
        else:
            assert not in_time(lambda: False)


def lose(pauses: Pauses, lost_s: float) -> None:
    """Stand in for the measurement of pauses."""
    pauses.lost_s = pauses.longest_s = lost_s
