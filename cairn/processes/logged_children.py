"""The children of a supervisor with a call log, and those of its re-run.

What children do is not decided by the supervisor's own calls: the log has what each method of the
group returned or raised, and the re-run returns or raises the same, without any children.
"""

import json
import logging
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any, Final, TypeVar

from cairn.errors import CairnError, Escalate
from cairn.processes.child import ChildStatus, SupervisorHost, ZygoteLost
from cairn.processes.supervisor import ChildGroup, EscalatedStart, StartFailed, UnknownChild
from cairn.runtime.call_log import CallLog
from cairn.runtime.call_records import RecordKind
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.process_exit import ExitReport

T = TypeVar("T")

_ERRORS: Final[dict[str, type[CairnError]]] = {
    one.__name__: one
    for one in (StartFailed, UnknownChild, EscalatedStart, Escalate, ZygoteLost, CairnError)
}


class LoggedChildren(ChildGroup):
    """A group of children that logs what its methods return and raise."""

    def __init__(
        self,
        launch: LaunchRequest,
        host: SupervisorHost,
        log: logging.Logger,
        on_exit: Callable[[], None],
        call_log: CallLog,
    ) -> None:
        """Take the children as `ChildGroup` does; log to `call_log`."""
        super().__init__(launch, host, log, on_exit)
        self._call_log = call_log
        self._logging = False  # a method may call another one

    def status(self) -> list[ChildStatus]:
        """Return the states of all children in start order."""
        return self._logged("status", super().status)

    def start_all(self) -> None:
        """Start the children that load at start."""
        self._logged("start_all", super().start_all)

    def reconcile(self) -> None:
        """Find children that have ended, and stop and start children."""
        self._logged("reconcile", super().reconcile)

    def check(self) -> None:
        """Kill the children that hang, and restore those that deviate."""
        self._logged("check", super().check)

    def hold(self, name: str, state: str) -> str:
        """Bring a child to a state and keep it there."""
        return self._logged("hold", lambda: super(LoggedChildren, self).hold(name, state))

    def load(self, name: str) -> None:
        """Start a child that is not loaded."""
        self._logged("load", lambda: super(LoggedChildren, self).load(name))

    def unload(self, name: str) -> None:
        """Stop a child and leave it stopped."""
        self._logged("unload", lambda: super(LoggedChildren, self).unload(name))

    def restart(self, name: str) -> None:
        """Stop and start a child, or load it."""
        self._logged("restart", lambda: super(LoggedChildren, self).restart(name))

    def stop_all(self) -> None:
        """Stop all children."""
        self._logged("stop_all", super().stop_all)

    def check_stops(self) -> None:
        """Raise `CairnError` if a child has failed while it was stopped."""
        self._logged("check_stops", super().check_stops)

    def _logged(self, method: str, call: Callable[[], T]) -> T:
        if self._logging:
            return call()
        self._logging = True
        outcome: dict[str, Any] = {"method": method}
        try:
            result = call()
            if isinstance(result, list):
                outcome["status"] = [asdict(one) for one in result]
            elif result is not None:
                outcome["result"] = result
            return result
        except CairnError as error:
            known = next(name for name, one in _ERRORS.items() if isinstance(error, one))
            outcome["error"] = [known, str(error)]
            raise
        finally:
            self._logging = False
            if self.stop_requested:
                outcome["stop_requested"] = True
            if self.finished is not None:
                outcome["finished"] = asdict(self.finished)
            self._call_log.add(RecordKind.OUTCOME, json.dumps(outcome))


class RecordedChildren(ChildGroup):
    """Returns and raises what a `LoggedChildren` has logged."""

    def __init__(self, outcome: Callable[[str], Mapping[str, Any]]) -> None:
        """Take what is logged for a method, in order, from `outcome`; nothing else is there."""
        self.stop_requested = False
        self.finished: ExitReport | None = None
        self._outcome = outcome

    def status(self) -> list[ChildStatus]:
        """Return the states of all children as logged."""
        return [ChildStatus(**one) for one in self._logged("status").get("status", ())]

    def hold(self, name: str, state: str) -> str:
        """Return what was logged."""
        return str(self._logged("hold").get("result", state))

    def load(self, name: str) -> None:
        """Raise what was logged."""
        self._logged("load")

    def unload(self, name: str) -> None:
        """Raise what was logged."""
        self._logged("unload")

    def restart(self, name: str) -> None:
        """Raise what was logged."""
        self._logged("restart")

    def start_all(self) -> None:
        """Raise what was logged."""
        self._logged("start_all")

    def reconcile(self) -> None:
        """Raise what was logged."""
        self._logged("reconcile")

    def check(self) -> None:
        """Raise what was logged."""
        self._logged("check")

    def stop_all(self) -> None:
        """Raise what was logged."""
        self._logged("stop_all")

    def check_stops(self) -> None:
        """Raise what was logged."""
        self._logged("check_stops")

    def _logged(self, method: str) -> Mapping[str, Any]:
        outcome = self._outcome(method)
        self.stop_requested = bool(outcome.get("stop_requested"))
        finished = outcome.get("finished")
        self.finished = None if finished is None else ExitReport(**finished)
        if "error" in outcome:
            name, text = outcome["error"]
            raise _ERRORS.get(name, CairnError)(text)
        return outcome
