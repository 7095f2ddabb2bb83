"""The main function of a component's own process."""

import logging
import signal
import sys
from os import getpid
from typing import Any

from cairn.bus.session import open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.errors import CairnError
from cairn.placement.launchers import Household, closing_words
from cairn.placement.order import Order

HEARTBEAT_S = 0.25
_SWITCH_INTERVAL_S = 0.0005
"""A computing handler lets the threads that receive messages in after at most so long."""

LOG_FORMAT = "%(asctime)s %(levelname)-7s %(name)s: %(message)s"


def main(argument: dict[str, Any]) -> None:
    """Run the component that the order `argument` names until it ends or SIGTERM comes."""
    order = Order.model_validate(argument)
    logging.basicConfig(level=logging.INFO, format=LOG_FORMAT, stream=sys.stderr)
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    code = 1
    reason = "it could not join the bus"
    try:
        bus = ZenohBus(open_peer(order.surroundings.endpoints), order.surroundings.domain)
        try:
            code, reason = _run(Household(order, bus))
        finally:
            bus.close()
    except CairnError as error:
        reason = str(error)
    print(closing_words(getpid(), reason), file=sys.stderr, flush=True)  # noqa: T201
    sys.exit(code)


def _run(household: Household) -> tuple[int, str]:
    hosted = household.hosted
    signal.signal(signal.SIGTERM, lambda *_: hosted.ask("shutdown"))
    try:
        while not hosted.ended.wait(HEARTBEAT_S):
            household.heartbeat()
    finally:
        household.close()
    if hosted.end is None:
        return 1, "its loop ended without a word"
    return (0 if hosted.end.normal else 1), hosted.end.reason
