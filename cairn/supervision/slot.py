"""The place of one child of a supervisor: leads what runs there to active, and to its end."""

from collections.abc import Callable
from dataclasses import dataclass

from cairn.errors import CairnError
from cairn.supervision.child import (
    Accident,
    Child,
    ChildEnd,
    ChildRules,
    Launcher,
    LauncherLost,
    Verb,
)
from cairn.supervision.events import ChildStatus, State, SupervisionEvent, What

_TERMINATE_LIMIT_S = 2.0  # from asking a child to end that has not stopped, to killing it
_KILL_LIMIT_S = 5.0  # for the kernel to end a killed process and its group


class StopRequested(Exception):  # noqa: N818 - leaves a start half-way
    """A stop was requested while a child was being started; the child still runs."""


@dataclass(frozen=True)
class StartFailure:
    """Why a child did not become active: an accident, or by its own words."""

    reason: str
    accident: bool


class Slot:
    """A child's place: what is meant to run there, and what does."""

    def __init__(
        self,
        spec: ChildRules,
        launcher: Launcher,
        observe: Callable[[SupervisionEvent], None],
        progress: Callable[[str, float], None],
        now: Callable[[], float],
    ) -> None:
        self.spec = spec
        self.child: Child | None = None
        self.incarnation = 0
        self.restarts = 0
        self.reason = ""
        self.state: State = "unloaded"
        self._unending: Child | None = None
        self._launcher = launcher
        self._observe = observe
        self._progress = progress
        self._now = now

    @property
    def stuck(self) -> bool:
        """Whether a former incarnation still runs, though it was killed."""
        return self._unending is not None and self._unending.wait(0) is None

    def status(self) -> ChildStatus:
        """How the child is."""
        return ChildStatus(self.spec.name, self.state, self.incarnation, self.restarts, self.reason)

    def start(self, stop_requested: Callable[[], bool]) -> StartFailure | None:
        """Launch the child and lead it to active; gives why that failed, None if it did not.

        Nothing of a child that failed runs. Raises `StopRequested`, `LauncherLost`.
        """
        limit_s = self.spec.start_timeout_s
        deadline = self._now() + limit_s
        self.incarnation += 1
        self.state = "starting"
        self.tell("starting")
        try:
            self._progress(f"launching {self.spec.name}", limit_s)
            self.child = self._launcher.launch(self.spec, self.incarnation, self.reason)
            verbs: tuple[Verb, ...] = ("configure", "activate")
            for verb in verbs:
                if stop_requested():
                    raise StopRequested
                left_s = deadline - self._now()
                if left_s <= 0:
                    raise Accident(f"it was not active after {limit_s:g} s")
                self._progress(f"starting {self.spec.name}: {verb}", left_s)
                self.child.request(verb, left_s)
        except LauncherLost:
            self.state = "ended"
            raise
        except CairnError as error:
            if stop_requested():  # which cut the step short
                raise StopRequested from error
            self.reason = self._own_words(error)
            self.tell("start_failed", self.reason)
            if self.child is not None:
                self._end(self.child, self.child.terminate, self.child.kill)
            self.child, self.state = None, "ended"
            return StartFailure(self.reason, isinstance(error, Accident))
        self.state = "active"
        self.tell("active")
        return None

    def look(self) -> ChildEnd | None:
        """How the child ended, None if it runs or there is none."""
        return None if self.child is None else self.child.wait(0)

    def stop(self) -> None:
        """Stop the child in good order if it can be, by force if not; nothing if there is none."""
        child = self.child
        if child is None:
            return
        end = child.wait(0)
        if end is None:
            deadline = self._now() + self.spec.stop_timeout_s
            verbs: tuple[Verb, ...] = ("deactivate", "shutdown")
            for verb in verbs if self.state == "active" else verbs[1:]:
                # Else the former step has ended it, or has taken all of the time.
                if child.wait(0) is None and self._now() < deadline:
                    self._stop_step(child, verb, deadline)
            end = child.wait(max(0.0, deadline - self._now()))
        if end is None:
            end = self._end(child, child.terminate, child.kill)
        self.child, self.state, self.reason = None, "ended", end.reason
        self.tell("stopped", end.reason, normal=end.normal)

    def kill(self) -> None:
        """End the child by force, at once; nothing if there is none."""
        if self.child is not None:
            self._end(self.child, self.child.kill)
        self.child, self.state = None, "ended"

    def ended(self, what: What, end: ChildEnd) -> None:
        """Note that the child ended."""
        self.child, self.state, self.reason = None, "ended", end.reason
        self.tell(what, end.reason, normal=end.normal)

    def tell(self, what: What, reason: str = "", *, normal: bool = True) -> None:
        """Have the supervisor's observer know."""
        name, incarnation = self.spec.name, self.incarnation
        self._observe(SupervisionEvent(self._now(), name, incarnation, what, reason, normal))

    def _stop_step(self, child: Child, verb: Verb, deadline: float) -> None:
        left_s = deadline - self._now()
        self.state = "stopping"
        self.tell("stopping", verb)
        try:
            self._progress(f"stopping {self.spec.name}: {verb}", left_s)
            child.request(verb, left_s)
        except Accident as error:
            if child.wait(0) is None:  # else it is told how it ended
                self.tell("stop_failed", f"{verb}: {error}")
        except Exception as error:  # the other children must be stopped all the same
            self.tell("stop_failed", self._own_words(error))

    def _own_words(self, error: Exception) -> str:
        return str(error).removeprefix(f"{self.spec.name}: ")

    def _end(self, child: Child, *steps: Callable[[], None]) -> ChildEnd:
        """Take steps of growing force, the last one killing, until the child has ended."""
        for step in steps:
            limit_s = _KILL_LIMIT_S if step is steps[-1] else _TERMINATE_LIMIT_S
            self._progress(f"ending {self.spec.name} by force", limit_s)
            try:
                step()
            except Exception as error:  # as above
                self.tell("stop_failed", str(error))
                limit_s = 0.0
            end = child.wait(limit_s)
            if end is not None:
                return end
        self._unending = child
        reason = "did not end even when killed"
        self.tell("stop_failed", reason)
        return ChildEnd(False, reason)
