"""Somebody is waited for until it is there, whatever was there before."""

import threading

import pytest

from cairn.bus.discovery import QueryableWatcher
from tests.cairn.bus.network import Network
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes


KEY = "@cairn/0/component/robot/base"


def test_who_is_there_already_is_not_waited_for(network: Network) -> None:
    asks, answers = network.bus().session, network.bus().session
    answers.declare_queryable(KEY, lambda _: None)

    with QueryableWatcher(asks, KEY) as arrival:
        assert arrival.wait(LIMIT_S)


def test_a_former_one_that_has_gone_is_not_taken_for_the_next(network: Network) -> None:
    asks, former, latter = (network.bus().session for _ in range(3))
    queryable = former.declare_queryable(KEY, lambda _: None)
    with QueryableWatcher(asks, KEY) as arrival:
        assert arrival.wait(LIMIT_S)
        queryable.undeclare()
        assert arrival.wait_gone(LIMIT_S)

        starts = threading.Timer(0.2, lambda: latter.declare_queryable(KEY, lambda _: None))
        starts.start()
        try:
            assert arrival.wait(LIMIT_S)
        finally:
            starts.join()


def test_the_wait_for_who_will_not_come_can_be_ended(network: Network) -> None:
    with QueryableWatcher(network.bus().session, KEY) as arrival:
        ends = threading.Timer(0.2, arrival.give_up)
        ends.start()
        try:
            assert not arrival.wait(LIMIT_S)
        finally:
            ends.join()
