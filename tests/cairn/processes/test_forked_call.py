"""Calls of functions in a fork of the zygote: answers, errors, and processes without an answer."""

import os
import signal
import sys

import pytest

from cairn import CairnError
from cairn.processes.forked_call import call_in_fork
from cairn.processes.launcher import ZygoteProcess
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes


def divide(numbers: list[int]) -> dict[str, float]:
    dividend, divisor = numbers
    if divisor == 0:
        raise CairnError(f"{dividend} cannot be divided; give another divisor")
    return {"quotient": dividend / divisor, "parent": os.getppid()}


def end_without_answer(_: None) -> None:
    sys.stderr.write("the disk is broken\n")
    sys.stderr.flush()
    os._exit(3)


def kill_zygote(_: None) -> None:
    os.kill(os.getppid(), signal.SIGKILL)
    signal.pause()  # its end ends this process


def test_result_of_a_call_comes_from_a_fork_of_the_zygote(zygote: ZygoteProcess) -> None:
    result = call_in_fork(zygote, "divider", f"{__name__}:divide", [6, 4], timeout_s=LIMIT_S)

    assert result == {"quotient": 1.5, "parent": zygote.process.pid}


def test_error_of_a_call_is_raised_with_its_text(zygote: ZygoteProcess) -> None:
    with pytest.raises(CairnError, match=r"^6 cannot be divided; give another divisor$"):
        call_in_fork(zygote, "divider", f"{__name__}:divide", [6, 0], timeout_s=LIMIT_S)


def test_call_whose_process_or_zygote_ends_fails_with_the_reason(zygote: ZygoteProcess) -> None:
    with pytest.raises(CairnError, match=r"process check failed .*code 3: the disk is broken"):
        call_in_fork(zygote, "check", f"{__name__}:end_without_answer", None, timeout_s=LIMIT_S)
    with pytest.raises(CairnError, match=r"process check failed .*SIGKILL"):
        call_in_fork(zygote, "check", f"{__name__}:kill_zygote", None, timeout_s=LIMIT_S)
    with pytest.raises(CairnError, match=r"the zygote failed .*SIGKILL"):
        call_in_fork(zygote, "check", f"{__name__}:kill_zygote", None, timeout_s=LIMIT_S)
