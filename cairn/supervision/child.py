"""What a supervisor knows of a component, wherever it runs: the contracts Child and Launcher."""

from dataclasses import dataclass
from typing import Literal, Protocol

from cairn.errors import CairnError
from cairn.supervision.policy import Restart

Load = Literal["at_start", "on_request"]
Verb = Literal["configure", "activate", "deactivate", "shutdown"]


class LauncherLost(CairnError):  # noqa: N818 - an event as much as an error
    """All that a launcher had started has ended, and it can start nothing any more."""


class Accident(CairnError):  # noqa: N818 - what befell the child
    """A child was killed or did not answer in time, and did not say itself why it fails."""


@dataclass(frozen=True)
class ChildRules:
    """How a supervisor is to keep one child running; time limits in seconds."""

    name: str
    restart: Restart = "permanent"
    significant: bool = False
    load: Load = "at_start"
    start_timeout_s: float = 60.0  # from launch to active
    stop_timeout_s: float = 5.0  # for stopping in good order, then it is terminated and killed


@dataclass(frozen=True)
class ChildEnd:
    """How a child ended; the reason is a sentence's part, such as "was killed by SIGSEGV".

    A child whose work is done ended normally, with `success` or without.
    """

    normal: bool
    reason: str
    success: bool = True


class Child(Protocol):
    """A running component, in a process of its own or not."""

    def request(self, verb: Verb, timeout_s: float) -> None:
        """Have it make a transition of its life cycle.

        Raises `CairnError` with the component's own words if it fails, `Accident` with the cause
        if it has ended or does not answer within `timeout_s` seconds.
        """
        ...

    def terminate(self) -> None:
        """Ask it to end, in a process by SIGTERM; nothing if it has ended."""
        ...

    def kill(self) -> None:
        """End it by force; nothing if it has ended."""
        ...

    def wait(self, timeout_s: float) -> ChildEnd | None:
        """Wait for its end at most `timeout_s` seconds (0: only look); None if it still runs."""
        ...


class Launcher(Protocol):
    """Starts components."""

    def launch(self, spec: ChildRules, incarnation: int, previous_exit: str) -> Child:
        """Start a child for the `incarnation`th time (from 1), and give it once it takes requests.

        `previous_exit` says in words how the incarnation before ended, "" for the first.
        Raises `CairnError` with the cause if that fails, `Accident` if it is killed or takes longer
        than `start_timeout_s`; nothing of it runs then. Raises `LauncherLost` if that is not the
        child's fault.
        """
        ...
