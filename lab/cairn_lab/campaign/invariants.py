"""What an invariant is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Final

from cairn.deployment.model import Deployment
from cairn.runtime.parameters import Config
from cairn_lab.campaign.entry_points import KindGroup
from cairn_lab.campaign.fault import Injection
from cairn_lab.campaign.observations import (
    DeploymentEnded,
    GoalEnded,
    LogLine,
    Processes,
)


class Invariant:
    """Something that must hold all the time; derive from it to add one.

    Each method returns its violations, each as one sentence. The campaign calls them one at a
    time, on one thread. `config_type` declares its parameters. Times are in
    seconds since the campaign began.
    """

    config_type: ClassVar[type[Config]] = Config

    topics: Mapping[str, type[Any]] = {}
    """Topics whose messages `on_message` gets: short or full name, and class of the messages."""

    def __init__(self, config: Config) -> None:
        """Take the parameters, an instance of `config_type`."""
        self.config = config

    def on_start(self, at_s: float, deployment: Deployment) -> Iterable[str]:
        """All components are active, after each launch."""
        return ()

    def on_message(self, at_s: float, topic: str, message: Any) -> Iterable[str]:
        """A message was published on one of `topics`."""
        return ()

    def on_log(self, line: LogLine) -> Iterable[str]:
        """`cairn up` has printed a line."""
        return ()

    def on_processes(self, at_s: float, processes: Processes) -> Iterable[str]:
        """Once a second: the processes of the run."""
        return ()

    def on_fault(self, at_s: float, kind: str, fault: Injection) -> Iterable[str]:
        """A fault was injected."""
        return ()

    def on_undo(self, at_s: float, kind: str, fault: Injection) -> Iterable[str]:
        """A fault that lasted for some time was undone."""
        return ()

    def on_goal(self, goal: GoalEnded) -> Iterable[str]:
        """A goal has ended."""
        return ()

    def on_end(self, end: DeploymentEnded) -> Iterable[str]:
        """`cairn up` has ended; all its files can be read."""
        return ()

    def on_finish(self, at_s: float) -> Iterable[str]:
        """The campaign has ended."""
        return ()


INVARIANTS: Final = KindGroup("cairn.invariants", "invariant", Invariant)
