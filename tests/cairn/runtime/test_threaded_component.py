"""The guarantees of a component on a thread of its own."""

import threading
from collections.abc import Iterator
from typing import Any

import pytest

from cairn import every, on
from cairn.bus.lockstep_bus import LockstepBus
from cairn.runtime.component import ComponentContext
from cairn.runtime.process_exit import ExitReport
from cairn.schemas.std_msgs import String
from tests.cairn.runtime.base import Base, word
from tests.cairn.runtime.threaded import ThreadedComponent
from tests.patience import LIMIT_S


class Slow(Base):
    """Blocks in each handler until it is released."""

    def __init__(self, context: ComponentContext) -> None:
        super().__init__(context)
        self.within = threading.Semaphore(0)
        self.release = threading.Event()
        self.at_once = 0
        self.most_at_once = 0

    def stay(self) -> None:
        self.at_once += 1
        self.most_at_once = max(self.most_at_once, self.at_once)
        self.within.release()
        assert self.release.wait(LIMIT_S)
        self.at_once -= 1

    @on("word")
    def receive(self, word: String) -> None:
        self.stay()

    @every(hz=1000)
    def tick(self) -> None:
        self.stay()

    def on_request(self, verb: str, arguments: Any) -> str:
        self.stay()
        return "done"


@pytest.fixture
def slow() -> Iterator[ThreadedComponent]:
    threaded = ThreadedComponent(Slow, LockstepBus(), name="slow")
    yield threaded
    component = threaded.runtime.component
    assert isinstance(component, Slow)
    component.release.set()
    threaded.close()


def test_status_names_the_current_handler_and_its_duration(slow: ThreadedComponent) -> None:
    component = slow.runtime.component
    assert isinstance(component, Slow)
    assert slow.runtime.status().handler == ""
    slow.activate()
    assert component.within.acquire(timeout=LIMIT_S)

    first, second = slow.runtime.status(), slow.runtime.status()

    assert first.handler == "tick"
    assert 0 <= first.handler_s < second.handler_s
    assert first.state == "active"


def test_timers_messages_and_requests_are_handled_one_at_a_time(slow: ThreadedComponent) -> None:
    component = slow.runtime.component
    assert isinstance(component, Slow)
    slow.activate()
    assert component.within.acquire(timeout=LIMIT_S)
    for _ in range(20):
        slow.loop.deliver(lambda: slow.runtime.run("receive", component.receive, word("a")))
        slow.loop.post(lambda: slow.runtime.run("receive", component.receive, word("b")))
    component.release.set()

    assert slow.request("wait") == "done"
    assert component.most_at_once == 1


def test_overloading_timers_do_not_block_requests(slow: ThreadedComponent) -> None:
    component = slow.runtime.component
    assert isinstance(component, Slow)
    slow.activate()
    component.release.set()

    assert [slow.request("wait") for _ in range(20)] == ["done"] * 20
    assert slow.request("deactivate") == "inactive"


def test_finished_component_ends_its_thread() -> None:
    class Finishes(Base):
        def on_activate(self) -> None:
            self.finish("nothing to do")

    threaded = ThreadedComponent(Finishes, LockstepBus())
    threaded.activate()

    assert threaded.ended.wait(LIMIT_S)
    threaded.join()
    assert threaded.end == ExitReport(True, "nothing to do")
