"""Starts a supervisor's children, each in a process of its own or in the supervisor's."""

import contextlib
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from pathlib import Path

from cairn.bus.bus import full_name
from cairn.bus.control import NoReplyError, request
from cairn.bus.discovery import QueryableWatcher
from cairn.bus.keys import control_key
from cairn.bus.zenoh_bus import ZenohBus
from cairn.deployment.plugins import load_plugin
from cairn.errors import CairnError
from cairn.placement.hosted import Hosted
from cairn.placement.last_words import LastWords
from cairn.runtime.launch_request import LaunchRequest
from cairn.supervision.child import Accident, Child, ChildEnd, ChildRules, Verb
from cairn.supervision.child_process import ChildExit, ChildProcess
from cairn.supervision.component import SupervisorComponent
from cairn.supervision.zygote_client import SpawnFailed, ZygoteClient, ZygoteLost

ENTRY = "cairn.placement.process:main"
TRACEBACK_SIGNAL = signal.SIGUSR1
"""A component's process that gets it writes to its log what all of its threads are doing."""
_TRACEBACK_LIMIT_S = 0.2
_KILL_LIMIT_S = 5.0
_WORDS_LEAD_S = 0.2
_ENDING_LIMIT_S = 5.0  # between leaving the bus and the end of the process, in either order


class Household:
    """A component hosted in this process, with what it launches if it is a supervisor."""

    def __init__(self, order: LaunchRequest, bus: ZenohBus) -> None:
        """Construct the component and let it answer; `CairnError` if that fails."""
        self.hosted = Hosted(order, bus)
        self.launcher: HostLauncher | None = None
        component = self.hosted.runtime.component
        if isinstance(component, SupervisorComponent):
            self.launcher = HostLauncher(self.hosted)
            spec = order.spec
            component.adopt(spec.children, spec.supervision, self.launcher, self.hosted)
        self.hosted.start()

    def heartbeat(self) -> None:
        """Publish the heartbeats of the component and of all below it in this process."""
        self.hosted.runtime.heartbeat.publish()
        if self.launcher is not None:
            self.launcher.heartbeat()

    def request_stop(self) -> None:
        """Have nothing started any more below, and cut short what is under way; any thread."""
        component = self.hosted.runtime.component
        if isinstance(component, SupervisorComponent) and self.launcher is not None:
            component.children.request_stop()
            self.launcher.request_stop()

    def close(self) -> None:
        """Leave the bus; kill what is left of the children."""
        self.hosted.close()
        if self.launcher is not None:
            self.launcher.close()


class HostLauncher:
    """Launches the children of one supervisor that is hosted in this process."""

    def __init__(self, supervisor: Hosted) -> None:
        self._supervisor = supervisor
        self._order = supervisor.order
        self._zygote: ZygoteClient | None = None
        self._here: list[Household] = []
        self._starting: ProcessChild | None = None

    def launch(self, spec: ChildRules, incarnation: int, previous_exit: str) -> Child:
        """Start a child and wait until it can be asked; `CairnError` with the cause if not."""
        order = LaunchRequest(
            name=spec.name,
            parent=self._order.name,
            incarnation=incarnation,
            previous_exit=previous_exit,
            spec=self._order.spec.children[spec.name],
            context=self._order.context,
        )
        if order.spec.placement == "in_process":
            return self._launch_here(order)
        return self._launch_process(order, spec.start_timeout_s)

    def heartbeat(self) -> None:
        """Publish the heartbeats of the children hosted in this process, and of theirs."""
        for household in tuple(self._here):
            household.heartbeat()

    def request_stop(self) -> None:
        """Ask the child that is being started, if there is one, to end; from any thread."""
        for household in tuple(self._here):
            household.request_stop()
        if self._starting is not None:
            self._starting.give_up()

    def close(self) -> None:
        """Kill what is left of the children."""
        for household in self._here:
            household.close()
        if self._zygote is not None:
            self._zygote.close()

    def _launch_process(self, order: LaunchRequest, timeout_s: float) -> "ProcessChild":
        context = order.context
        name = full_name(context.robot, order.name)
        log = Path(context.log_folder) / f"{order.name}.log"
        fresh = order.spec.interpreter == "fresh"
        session = self._supervisor.bus.session
        words = LastWords(log)
        with QueryableWatcher(session, control_key(context.domain, name)) as arrival:
            if not arrival.wait_gone(min(timeout_s, _ENDING_LIMIT_S)):
                raise Accident(
                    f"somebody else on this bus answers as {name}; stop that, or give this robot "
                    "another name (`--set robot=NAME`)"
                )
            try:
                process = self._client().spawn(
                    order.name,
                    ENTRY,
                    order.model_dump(mode="json"),
                    log,
                    fresh=fresh,
                    needs=[] if fresh else [load_plugin(order.spec.plugin).__module__],
                    timeout_s=timeout_s,
                )
            except SpawnFailed as error:
                raise CairnError(_in_short(error, order.name, log)) from error
            child = ProcessChild(process, words, name, self._supervisor, arrival.give_up)
            self._starting = child
            process.on_end(lambda _: arrival.give_up())
            if arrival.wait(timeout_s):
                return child
        end = child.wait(0)
        if end is None:
            process.kill()
            child.wait(_KILL_LIMIT_S)
            raise Accident(f"it did not join the bus within {timeout_s:g} s; log: {log}")
        if process.exit is not None and process.exit.signal is not None:
            raise Accident(end.reason)
        raise CairnError(end.reason)

    def _client(self) -> ZygoteClient:
        if self._zygote is None:
            self._zygote = ZygoteClient(
                Path(self._order.context.zygote), self._on_exit, self._on_lost
            )
        return self._zygote

    def _launch_here(self, order: LaunchRequest) -> "InProcessChild":
        household = Household(order, self._supervisor.bus)
        household.hosted.on_end = self._changed
        self._here = [other for other in self._here if not other.hosted.ended.is_set()]
        self._here.append(household)
        return InProcessChild(household)

    def _on_exit(self, exit_: ChildExit) -> None:  # noqa: ARG002 - whoever asks finds it ended
        self._changed()

    def _on_lost(self, lost: ZygoteLost) -> None:
        self._supervisor.runtime.log.critical("%s", lost)
        self._changed()

    def _changed(self) -> None:
        component = self._supervisor.runtime.component
        if isinstance(component, SupervisorComponent):
            component.child_changed()


class ProcessChild:
    """A component in a process of its own, asked over the bus."""

    def __init__(
        self,
        process: ChildProcess,
        words: LastWords,
        full: str,
        supervisor: Hosted,
        give_up_launch: Callable[[], None],
    ) -> None:
        self._process = process
        self._words = words
        self._full = full
        self._supervisor = supervisor
        self._give_up_launch = give_up_launch
        self._start_under_way = True
        self._answer: Future[None] = Future()  # to the last step of starting

    def request(self, verb: Verb, timeout_s: float) -> None:
        """Have it make a transition; a step of starting may be cut short by `give_up`."""
        asked_at = time.monotonic()
        try:
            if self._start_under_way and verb in ("configure", "activate"):
                self._ask_interruptibly(verb, timeout_s)
                self._start_under_way = verb == "configure"
            else:
                self._ask(verb, timeout_s)
        except CairnError as error:
            if not isinstance(error, NoReplyError):  # its own words
                self.wait(_WORDS_LEAD_S)  # after them it ends
                raise
            # Its leaving the bus is told before its end.
            left_s = timeout_s - (time.monotonic() - asked_at)
            end = self.wait(max(0.0, min(left_s, _ENDING_LIMIT_S)))
            if end is None and time.monotonic() - asked_at >= timeout_s:
                raise Accident(f"no answer within {timeout_s:.1f} s") from None
            if end is None:
                raise Accident(str(error)) from None
            if not end.normal or verb != "shutdown":
                raise Accident(end.reason) from None

    def give_up(self) -> None:
        """Cut short the start that is under way, and ask the process to end; from any thread."""
        if self._start_under_way:
            self._give_up_launch()
            _answer(self._answer, CairnError("a stop was requested"))
            self.terminate()

    def terminate(self) -> None:
        """Ask its process to end."""
        self._process.terminate()

    def kill(self) -> None:
        """Kill its process group; its log gets to know what it was doing."""
        self._process.signal(TRACEBACK_SIGNAL)
        if self._process.wait(_TRACEBACK_LIMIT_S) is None:
            self._process.kill()

    def wait(self, timeout_s: float) -> ChildEnd | None:
        """Its end, with its last words."""
        exit_ = self._process.wait(timeout_s)
        return None if exit_ is None else self._words.end_of(exit_)

    def _ask(self, verb: Verb, timeout_s: float) -> None:
        domain = self._supervisor.order.context.domain
        session = self._supervisor.bus.session
        request(session, domain, self._full, verb, timeout_s=max(0.01, timeout_s))

    def _ask_interruptibly(self, verb: Verb, timeout_s: float) -> None:
        self._answer = answer = Future[None]()

        def ask() -> None:
            try:
                self._ask(verb, timeout_s)
                _answer(answer, None)
            except Exception as error:
                _answer(answer, error)

        threading.Thread(target=ask, name=f"{verb} {self._full}", daemon=True).start()
        answer.result()  # `_ask` keeps the time limit


class InProcessChild:
    """A component on a thread of its supervisor's process; it cannot be killed."""

    def __init__(self, household: Household) -> None:
        self._household = household
        self._hosted = household.hosted

    def request(self, verb: Verb, timeout_s: float) -> None:
        """Have it make a transition."""
        self._hosted.request(verb, timeout_s)

    def terminate(self) -> None:
        """Ask it to shut down."""
        self._hosted.ask("shutdown")

    def kill(self) -> None:
        """A thread cannot be killed: the process that it hangs in has to end, and says so."""
        raise CairnError(
            f"{self._hosted.order.name} is placed in its supervisor's process and cannot be "
            "killed; give it `placement: process`, or restart the supervisor"
        )

    def wait(self, timeout_s: float) -> ChildEnd | None:
        """Its end."""
        if not self._hosted.ended.wait(timeout_s) or self._hosted.end is None:
            return None
        self._household.close()
        end = self._hosted.end
        return (
            ChildEnd(True, end.reason, end.success)
            if end.normal
            else ChildEnd(False, f"failed: {end.reason}")
        )


def _in_short(error: SpawnFailed, name: str, log: Path) -> str:
    """The first line of an error; all of it, a traceback perhaps, goes to the component's log."""
    text = str(error).removeprefix(f"{name} could not be started: ")
    with contextlib.suppress(OSError), log.open("a", encoding="utf-8") as file:
        file.write(f"{text}\n")
        return f"{text.partition(chr(10))[0]} (log {log})"
    return text


def _answer(future: "Future[None]", error: Exception | None) -> None:
    with contextlib.suppress(InvalidStateError):  # answered before
        if error is None:
            future.set_result(None)
        else:
            future.set_exception(error)
