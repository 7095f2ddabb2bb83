"""A deployment in lockstep, with a hook for what is published; adapts the lockstep harness."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cairn import RELIABLE, Qos
from cairn.deployment.model import Deployment
from cairn.testing.lockstep import DeploymentHarness, LockstepReading


class Deployed:
    """Nothing is started before the first `wait`, `ask` or `publish`."""

    def __init__(self, deployment: Deployment, seed: int = 1) -> None:
        self.harness = DeploymentHarness(deployment, seed=seed)
        self.run = self.harness.run
        self._is_new = False  # whether a message was received since the last `hear`

    @property
    def now(self) -> float:
        """Virtual time [s]."""
        return self.harness.now

    def wait(self, seconds: float) -> None:
        """Let virtual time advance."""
        self.harness.run_for(seconds)
        self._hear_new()

    def await_that(self, condition: Callable[[], bool], limit_s: float = 300.0) -> None:
        """Let virtual time advance until a condition holds."""
        try:
            self.harness.run_until(lambda: self._hear_new() or condition(), limit_s)
        except AssertionError as error:
            raise AssertionError(f"{error}; {self}") from None

    def hear(self) -> None:
        """Take new messages of the topics that are read; called before conditions are checked."""

    def ask(self, component: str, verb: str, **arguments: Any) -> Any:
        """Return a component's reply to a request; its immediate effects have happened then."""
        answer = self.harness.request(component, verb, **arguments)
        self._hear_new()
        return answer

    def read(self, topic: str, message: type[Any]) -> LockstepReading[Any]:
        """Collect what is published on a topic."""
        return self.harness.read(topic, message, on_message=self._note)

    def publish(self, topic: str, message: Any, qos: Qos = RELIABLE) -> None:
        """Publish a message; its immediate effects have happened then."""
        self.harness.publish(topic, message, qos=qos)
        self._hear_new()

    def begin(self) -> None:
        """Configure and activate all, once; raises `CairnError` if that fails."""
        self.harness.start()

    def end(self) -> None:
        """Shut all down in order, unless it has ended."""
        self.harness.shutdown()

    def silence(self, component: str) -> None:
        """Suspend a component, as if its process were stopped."""
        self.harness.suspend(component)

    def _note(self) -> None:
        self._is_new = True

    def _hear_new(self) -> bool:
        """Call `hear` if a message was received. Always false."""
        if self._is_new:
            self._is_new = False
            self.hear()
        return False


def taken(reading: LockstepReading[Any]) -> list[Any]:
    """Return the messages since the last call."""
    return reading.take()
