"""The main function of a component's own process."""

import faulthandler
import logging
import os
import signal
import sys
from typing import Any

from cairn.bus.session import open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.errors import CairnError
from cairn.placement.attendance import Attendance
from cairn.placement.last_words import closing_words
from cairn.placement.launchers import TRACEBACK_SIGNAL, Household
from cairn.process_exit import end_process
from cairn.runtime.launch_request import LaunchRequest
from cairn.supervision.child_process import WITHOUT_SUCCESS

_SWITCH_INTERVAL_S = 0.0005
"""A computing handler lets the threads that receive messages in after at most so long."""

LOG_FORMAT = "%(asctime)s %(levelname)-7s %(name)s: %(message)s"


def main(argument: dict[str, Any]) -> None:
    """Run the component that the order `argument` names until it ends or SIGTERM comes."""
    order = LaunchRequest.model_validate(argument)
    logging.basicConfig(level=logging.INFO, format=LOG_FORMAT, stream=sys.stderr)
    faulthandler.register(TRACEBACK_SIGNAL, all_threads=True)
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    code = 1
    reason = "it could not join the bus"
    try:
        bus = ZenohBus(open_peer(order.context.endpoints), order.context.domain)
        try:
            code, reason = _run(Household(order, bus))
        finally:
            bus.close()
    except CairnError as error:
        reason = str(error)
        if error.__cause__ is not None:  # of the plugin: its author wants the traceback
            logging.getLogger("cairn").error("%s", error, exc_info=error.__cause__)
    _say(closing_words(os.getpid(), reason))
    end_process(code)


def _run(household: Household) -> tuple[int, str]:
    hosted = household.hosted
    attendance = Attendance(household)
    try:
        with attendance.signals(signal.SIGTERM, signal.SIGINT):
            attendance.until_end(_nothing_more, impatient=False)
    finally:
        household.close()
    if hosted.end is None:
        return 1, "its loop ended without a word"
    end = hosted.end
    if not end.normal:
        return 1, end.reason
    return (0 if end.success else WITHOUT_SUCCESS), end.reason


def _nothing_more() -> None:
    """A component's process has nothing else to do on its main thread."""


def _say(words: str) -> None:
    try:
        print(words, file=sys.stderr, flush=True)  # noqa: T201
    except OSError:  # a full disk: the exit code still tells, if nothing is flushed at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
