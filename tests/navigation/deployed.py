"""A deployment in lockstep in the hands of a test: let time pass, ask, publish, read."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cairn import RELIABLE, SECOND, Qos
from cairn.bus.bus import full_name
from cairn.deployment.model import Deployment
from cairn.placement.lockstep import LockstepRun

_MANY = Qos("reliable", "transient_local", 1_000_000)


class Deployed:
    """Nothing has begun before the first `wait`, `ask` or `publish`."""

    def __init__(self, deployment: Deployment, seed: int = 1) -> None:
        self.run = LockstepRun(deployment, seed=seed)
        self._outside = self.run.bus.node("/robot/operator", _heed)
        self._writers: dict[str, Any] = {}
        self._began = False
        self._told = False  # whether anything has come since the last look

    @property
    def now(self) -> float:
        """Virtual time [s]."""
        return self.run.executor.now() / SECOND

    def wait(self, seconds: float) -> None:
        """Let time pass, and what is to happen then happen."""
        self.begin()
        executor = self.run.executor
        end = executor.now() + round(seconds * SECOND)
        over: list[bool] = []

        def leave(turns: int) -> None:
            if turns:
                executor.at(end, lambda: leave(turns - 1))
            else:
                over.append(True)

        executor.at(end, lambda: leave(100))
        executor.run(lambda: self._look() or bool(over))

    def await_that(self, so: Callable[[], bool], limit_s: float = 300.0) -> None:
        """Let time pass until something is so."""
        self.begin()
        executor, until = self.run.executor, self.now + limit_s
        executor.at(round(until * SECOND), _nothing)
        executor.run(lambda: self._look() or so() or self.now >= until)
        assert so(), f"not so within {limit_s} s; {self}"

    def hear(self) -> None:
        """Called when something was told on a topic that is read: take it."""

    def ask(self, component: str, verb: str, **arguments: Any) -> Any:
        """What a component answers to a request; what follows at once has happened then."""
        self.begin()
        answer = self.run.runtime(component).request(verb, arguments)
        self.wait(0.0)
        return answer

    def read(self, topic: str, message: type[Any]) -> Any:
        """All that is published on a topic, to be taken."""
        return self._outside.subscribe(full_name("robot", topic), message, _MANY, self._note)

    def publish(self, topic: str, message: Any, qos: Qos = RELIABLE) -> None:
        """Put a message on a topic; what follows at once has happened then."""
        self.begin()
        writer = self._writers.get(topic)
        if writer is None:
            name = full_name("robot", topic)
            writer = self._writers[topic] = self._outside.advertise(name, type(message), qos)
        writer.publish(message)
        self.wait(0.0)

    def begin(self) -> None:
        """Configure and activate all, once; raises `CairnError` if that cannot be."""
        if self._began:
            return
        self._began = True
        self.run.start()

    def end(self) -> None:
        """Stop all in good order, unless it has ended."""
        if self._began:
            self.run.shutdown()

    def silence(self, component: str) -> None:
        """Have a component do nothing any more, like a process that was stopped."""
        self.run.suspend(component)

    def _note(self) -> None:
        self._told = True

    def _look(self) -> bool:
        """Before every event. Always false."""
        if self._told:
            self._told = False
            self.hear()
        return False


def taken(reader: Any) -> list[Any]:
    """All that waits there."""
    return list(iter(reader.take, None))


def _nothing() -> None:
    """Nobody is woken."""


def _heed(complaint: str) -> None:
    raise AssertionError(complaint)
