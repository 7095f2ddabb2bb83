"""A child of a supervisor that runs on another machine of the robot.

The root of that machine starts it, watches it and restarts it; a supervisor here only requests that
it is loaded, held or unloaded. It never counts as failed because its machine cannot be reached: it
is *lost*, and what follows is its `on_loss` in the deployment. Nothing is killed over a link.

Log lines have the form of `cairn.processes.supervisor`, with these further events:

| event | level | meaning |
|---|---|---|
| `child lost: NAME: REASON` | WARNING, DEBUG with `on_loss: ignore` | it cannot be reached |
| `child found: NAME` | INFO | its machine is reached again, and it is active |
| `child resting: NAME: REASON` | WARNING | its link is slow; its fallback works instead |
| `child resumed: NAME: REASON` | INFO | its link is no longer slow |
| `child hold failed: NAME: REASON` | ERROR | it did not rest or resume as its link requires |
"""

import logging
import math
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any, Protocol

from cairn.errors import CairnError
from cairn.processes.child import (
    AnyChild,
    ChildUnavailable,
    StartResult,
    State,
    SupervisorHost,
)
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.lifecycle import LifecycleState
from cairn.runtime.process_exit import ExitReport
from cairn.schemas.cairn_msgs import MachineChild

_STEP_S = 0.05
_SLOW_CHECKS = 3  # in a row, of two in a second: then the link is slow
_QUICK_CHECKS = 6  # in a row: then it is not any more
_FIRST_RETRY_S, _LONGEST_RETRY_S = 1.0, 30.0  # after a load that failed while its machine is up
_SETTLE_S = 1.0  # after an answer, in which reports of another state may be older than it
_TRANSFER_S = 1.0  # longer than the other root may take, for the request and its answer


class Machines(Protocol):
    """The other machines of the robot, as this process sees them; from any thread."""

    def silence(self, machine: str) -> str:
        """Return why a machine counts as lost, "" if it is up."""

    def child(self, machine: str, name: str) -> MachineChild | None:
        """Return what the root of a machine has last reported of its child of that name."""

    def request(
        self, machine: str, verb: str, arguments: Mapping[str, Any], timeout_s: float
    ) -> "Future[Any]":
        """Make a request of the root of a machine.

        The future raises `ChildUnavailable` if it does not answer, `CairnError` if it refuses.
        """

    def round_trip_s(self, machine: str) -> float | None:
        """Return how long the last exchange with a machine took [s]; None before the first."""

    def wait_for_news(self, timeout_s: float) -> None:
        """Wait until a root reports something, at most `timeout_s` [s]."""


class RemoteChild(AnyChild):
    """One child of a supervisor on another machine; it has the methods of `Child`."""

    runs = False

    def __init__(
        self, name: str, parent: LaunchRequest, host: SupervisorHost, log: logging.Logger
    ) -> None:
        """`parent` is the supervisor's launch."""
        super().__init__(name, parent, host, log)
        assert self.spec.machine is not None
        self._machine = self.spec.machine
        self._loading: Future[Any] | None = None
        self._was_lost = False  # and has not been found again
        self._is_slow = False
        self._contrary_checks = 0
        self._holding: Future[Any] | None = None
        self._loaded_at = -math.inf  # when its root has answered that it is active [s]
        self._retry_s = 0.0
        self._retry_at = -math.inf  # before that it is not loaded again [s]

    def start(self, canceled: Callable[[], bool]) -> StartResult:
        """Have its machine load it, and wait until it is active.

        If the machine cannot be reached within its time for starting, or at once with `on_loss:
        ignore`, the child is lost, and the start has succeeded unless it is `on_loss: stop`.
        """
        deadline = self._host.awake() + self.spec.start_limit_s
        self.state = "starting"
        self.target = LifecycleState.ACTIVE
        machines = self._host.machines()
        while silence := machines.silence(self._machine):
            if canceled():
                return "canceled"
            if self.spec.on_loss == "ignore" or self._host.awake() >= deadline:
                return self._started_without(silence)
            self._host.report_progress(f"waiting for machine {self._machine}")
            machines.wait_for_news(_STEP_S)
        self._host.report_progress(f"loading {self.name} on machine {self._machine}")
        self.runs = True  # from now on a stop has to unload it
        loading = self._request_load()
        while not loading.done():
            if canceled():
                return "canceled"
            machines.wait_for_news(_STEP_S)
        self._loading = None
        try:
            loading.result()
        except ChildUnavailable:
            return self._started_without(machines.silence(self._machine) or self._no_answer("load"))
        except CairnError as error:
            self.runs = False
            self.reason, self.state = self._without_name(error), "ended"
            self._log_event(logging.ERROR, "start failed", self.reason)
            return "refused"
        self.state, self.reason, self._was_lost = "active", "", False
        self._loaded_at = self._host.awake()
        self._log_event(logging.INFO, "active")
        return "active"

    @property
    def needs_fallback(self) -> bool:
        """Whether something here has to do its work: it runs, but cannot be used."""
        return self.runs and (self.state == "lost" or self._is_slow)

    def poll(self) -> ExitReport | None:
        """Return None: its own machine judges how it has ended."""
        return None

    def check(self, canceled: Callable[[], bool]) -> ExitReport | None:
        """Find out whether its machine is lost or found again, and how it is there.

        Returns a report if it is lost and `on_loss` is `stop`.
        """
        if not self.runs or canceled():
            return None
        machines = self._host.machines()
        silence = machines.silence(self._machine)
        if silence:
            if self.state != "lost":
                self._lose(silence)
                if self.spec.on_loss == "stop":
                    return ExitReport(False, self.reason)
            return None
        reported = machines.child(self._machine, self.name)
        if self._loading is not None and not self._loading.done():
            return None
        loading, self._loading = self._loading, None
        if loading is not None:
            self._note_load(loading.exception())
        is_active = reported is not None and reported.state in ("active", "held")
        if not is_active and self._host.awake() - self._loaded_at < _SETTLE_S:
            return None  # the report may be older than the answer
        if reported is None or reported.state == "unloaded":
            # Its root has been restarted, for example.
            if self.target is LifecycleState.ACTIVE and self._host.awake() >= self._retry_at:
                self._request_load()
            return None
        self._note_reported(reported)
        self._check_speed(machines)
        if self._was_lost and self.state in ("active", "held"):
            self._was_lost = False
            self._log_event(logging.INFO, "found")
        return None

    def hold(self, state: LifecycleState) -> None:
        """Have its machine bring it to a state of its life cycle and keep it there.

        Raises `CairnError` if its machine cannot be reached, or with the component's own error.
        """
        if not self.runs:
            raise CairnError(f"{self.name}: it does not run; load it first")
        if silence := self._host.machines().silence(self._machine):
            raise CairnError(f"{self.name}: {silence}; try again when it is reached")
        self.target = state
        limit_s = max(self.spec.start_limit_s, self.spec.stop_limit_s) + _TRANSFER_S
        arguments = {"name": self.name, "state": state.value}
        self._host.machines().request(self._machine, "hold", arguments, limit_s).result()
        self.state = "active" if state is LifecycleState.ACTIVE else "held"
        self._log_event(logging.INFO, "held by request", str(state))

    def expect_stop(self, limit_s: float) -> None:
        """Do nothing: its machine cuts short a start by itself when it is to unload the child."""

    def stop(self, limit_s: float = math.inf) -> None:
        """Have its machine unload it, within `limit_s` [s]; a lost one may continue to run."""
        self.stop_failure = ""
        if not self.runs:
            return
        self.runs = False
        machines = self._host.machines()
        silence = machines.silence(self._machine)
        if not silence:
            self._host.report_progress(f"unloading {self.name} on machine {self._machine}")
            allowed_s = min(self.spec.stop_limit_s + _TRANSFER_S, limit_s)
            request = machines.request(
                self._machine, "unload", {"name": self.name}, max(_STEP_S, allowed_s)
            )
            try:
                request.result()
            except ChildUnavailable:
                silence = machines.silence(self._machine) or self._no_answer("unload")
            except CairnError as error:
                self.stop_failure = self._without_name(error)
        if silence:  # not a failure of the child, nor of its stop: its machine decides
            self.reason = f"{silence}; it may continue to run there"
        self.state = "ended"
        failure = self.stop_failure or (self.reason if silence else "")
        self._log_event(logging.WARNING if failure else logging.INFO, "stopped", failure)

    def _check_speed(self, machines: Machines) -> None:
        """Have a component with a fallback rest while its link is slow."""
        if self._holding is not None and self._holding.done():
            error, self._holding = self._holding.exception(), None
            if error is not None:
                self._log_event(logging.ERROR, "hold failed", self._without_name(error))
        round_trip_s = machines.round_trip_s(self._machine)
        if self.spec.fallback is None or round_trip_s is None:
            return
        limit_s = self.spec.fallback.max_round_trip_s
        is_contrary = (round_trip_s > limit_s) != self._is_slow
        self._contrary_checks = self._contrary_checks + 1 if is_contrary else 0
        if self._contrary_checks < (_QUICK_CHECKS if self._is_slow else _SLOW_CHECKS):
            return
        self._is_slow, self._contrary_checks = not self._is_slow, 0
        took = f"round trip {round_trip_s:.2f} s, limit {limit_s:g} s"
        state = "inactive" if self._is_slow else "active"
        self._holding = machines.request(
            self._machine, "hold", {"name": self.name, "state": state}, self.spec.stop_limit_s
        )
        if self._is_slow:
            self._log_event(logging.WARNING, "resting", f"link to {self._machine} is slow: {took}")
        else:
            self._log_event(logging.INFO, "resumed", took)

    def _request_load(self) -> "Future[Any]":
        self.incarnation += 1
        self._loading = self._host.machines().request(
            self._machine, "load", {"name": self.name}, self.spec.start_limit_s + _TRANSFER_S
        )
        return self._loading

    def _note_load(self, error: BaseException | None) -> None:
        """Log a load that has failed; wait before the next one, twice as long each time."""
        if error is None:
            self._retry_s, self._retry_at = 0.0, -math.inf
            return
        self._retry_s = min(_LONGEST_RETRY_S, max(_FIRST_RETRY_S, 2.0 * self._retry_s))
        self._retry_at = self._host.awake() + self._retry_s
        self.reason = self._without_name(error)
        self._log_event(
            logging.ERROR, "start failed", f"{self.reason}; trying again in {self._retry_s:g} s"
        )

    def _started_without(self, silence: str) -> StartResult:
        if self.spec.on_loss == "stop":
            self.runs, self.reason, self.state = False, silence, "ended"
            self._log_event(logging.ERROR, "start failed", self.reason)
            return "unavailable"
        self.runs = True
        self._lose(silence)
        return "active"

    def _no_answer(self, verb: str) -> str:
        return f"machine {self._machine} has not answered the request to {verb} it"

    def _lose(self, silence: str) -> None:
        self.state, self.reason, self._was_lost = "lost", silence, True
        self._loaded_at = self._retry_at = -math.inf
        self._retry_s = 0.0
        level = logging.DEBUG if self.spec.on_loss == "ignore" else logging.WARNING
        self._log_event(level, "lost", silence)

    def _note_reported(self, reported: MachineChild) -> None:
        self.reason = reported.reason
        states: dict[str, State] = {
            "starting": "starting", "active": "active", "held": "held", "stopping": "stopping",
        }  # fmt: skip
        self.state = states.get(reported.state, "ended")
