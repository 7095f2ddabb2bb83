"""A component's own process: its main function, its main thread's loop, the component's host."""

from __future__ import annotations

import faulthandler
import logging
import os
import resource
import signal
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future
from concurrent.futures import wait as wait_for
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

from cairn.bus.bus import full_name
from cairn.bus.control import ControlServer
from cairn.bus.session import open_peer, peer_socket
from cairn.bus.zenoh_bus import ZenohBus
from cairn.deployment.plugins import load_plugin
from cairn.errors import CairnError
from cairn.processes.child import ChildHandle, ChildUnavailable, complete
from cairn.processes.child_channel import (
    ChildChannel,
    Heartbeat,
    Request,
    StopAhead,
    TransitionAnswer,
    sendable,
)
from cairn.processes.launcher import TRACEBACK_SIGNAL, ProcessHandle, ZygoteClient
from cairn.processes.machines import RobotMachines
from cairn.processes.prepared import CODEC
from cairn.processes.supervisor import Supervisor
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.lifecycle import LifecycleState, Transition
from cairn.runtime.log_output import LogLimit, OutputFile, OutputHandler
from cairn.runtime.loop import ThreadLoop
from cairn.runtime.process_exit import ExitReport, end_process, log_reason
from cairn.runtime.rosout import RosoutHandler
from cairn.runtime.runtime import Runtime
from cairn.system.bell import Bell
from cairn.system.clock import SystemClock
from cairn.system.heap import return_free_memory
from cairn.system.signal_handlers import signal_handlers

T = TypeVar("T")

PERIOD_S = 0.25
"""Of heartbeats, and of what the component's thread does besides."""
PAUSE_S = 1.0
"""A thread that should run four times a second and has not run for so long was kept from it."""
_JOIN_LIMIT_S = 5.0
_FREE_MEMORY_S = 60.0
"""Free memory is returned to the system so often: it takes milliseconds, and an image afterwards
takes longer, since its memory is mapped again."""
_SWITCH_INTERVAL_S = 0.0005
"""A handler that computes yields to the threads that receive messages after at most so long."""
_ALLOCATED = 2
"""Not all that is allocated is used: of the shipped components at most 210 MiB are not, mostly the
stacks of about 25 threads, of 8 MiB each."""


def main(argument: dict[str, Any], end: socket.socket) -> None:
    """Run the component of the launch request `argument` until it ends or SIGTERM comes.

    `end` is this process's end of the channel to its supervisor.
    """
    os.register_at_fork(after_in_child=end.close)  # a forked helper must not hold it
    launch = LaunchRequest.model_validate(argument)
    logging.basicConfig(level=logging.INFO, handlers=[OutputHandler()])
    log_stacks_on_signal()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    _limit_allocation(launch.spec.memory_max_mib)
    report = ExitReport(False, "it could not join the bus")
    try:
        context = launch.context
        path = peer_socket(Path(context.socket_folder), launch.name)
        secret = context.session_secret
        limits = context.message_limits
        session = open_peer(context.endpoints, path, context.credentials, limits, secret)
        bus = ZenohBus(
            session, context.domain, secret, limits, CODEC, several_machines=bool(context.machine)
        )
        with closing(bus):
            report = _run(launch, bus, ChildChannel(end))
    except CairnError as error:
        report = ExitReport(False, str(error))
        if error.__cause__ is not None:  # an exception of the plugin: its author needs the trace
            log = logging.getLogger("cairn")
            log.error("component start failed: %s", error, exc_info=error.__cause__)
    log_reason(report.reason)
    end_process(report.exit_code)


def log_stacks_on_signal() -> None:
    """Have `TRACEBACK_SIGNAL` log the stacks of all threads; at the end of Python, do nothing."""
    # What is set now holds again when Python removes the handler, as it ends.
    signal.signal(TRACEBACK_SIGNAL, signal.SIG_IGN)
    faulthandler.register(TRACEBACK_SIGNAL, all_threads=True)


def _limit_allocation(memory_max_mib: int) -> None:
    """Have allocations fail beyond `_ALLOCATED` times a component's memory limit [MiB].

    Its supervisor kills it at the limit itself, but looks only twice a second, and not while it
    stops another child. `RLIMIT_DATA` alone would be no measure: it counts what is allocated but
    not used, such as the stacks of threads, 150 to 210 MiB. Each helper process inherits it.
    """
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    limit = _ALLOCATED * (memory_max_mib << 20)
    limit = limit if most == resource.RLIM_INFINITY else min(limit, most)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, most))


def _run(launch: LaunchRequest, bus: ZenohBus, channel: ChildChannel) -> ExitReport:
    context = launch.context
    log_file = Path(context.log_folder) / f"{launch.name}.log"
    output = OutputFile(log_file, context.storage.max_log_size, context.storage.old_logs)
    with closing(ComponentHost(launch, bus)) as host:
        host.start()
        loop = MainLoop(host)

        def on_turn() -> None:
            channel.send_heartbeat(host.heartbeat)
            output.check()

        with loop.stop_signals(signal.SIGTERM, signal.SIGINT), _answering(host, channel):
            loop.run(on_turn)
    return host.exit_report or ExitReport(False, "its loop ended without a report")


@contextmanager
def _answering(host: ComponentHost, channel: ChildChannel) -> Iterator[None]:
    """Answer the requests of the supervisor within the context, on a thread."""

    def answer(request: Request, made: Future[Any]) -> None:
        error = made.exception()
        channel.send_heartbeat(host.heartbeat)  # with the new state, before the answer
        channel.send_answer(
            TransitionAnswer(request.number, "" if error is None else sendable(str(error)))
        )

    def serve() -> None:
        while (message := channel.receive()) is not None:
            if isinstance(message, StopAhead):
                host.expect_stop(message.limit_s)
            else:
                host.send_request(message.verb).add_done_callback(partial(answer, message))

    thread = threading.Thread(target=serve, name="cairn supervision", daemon=True)
    thread.start()
    try:
        yield
    finally:
        channel.stop_receiving()
        thread.join()


class MainLoop:
    """The main thread of a process that hosts components: heartbeats, and signals to stop.

    It runs until a component has ended; a stop signal such as Ctrl-C has it shut down.
    """

    def __init__(self, host: ComponentHost) -> None:
        self._host = host
        self._bell = Bell()
        self._signals: deque[int] = deque()  # received and not handled yet
        self._stopping = False
        host.on_exit = self.wake_up

    def run(
        self,
        on_turn: Callable[[], None] = lambda: None,
        *,
        force: bool = False,
    ) -> bool:
        """Publish heartbeats until the component has ended, and call `on_turn` with each of them.

        Once a minute, the process returns its free memory to the system.

        `on_turn` is called a last time after the end. With `force`, a second stop signal ends the
        loop before the component has ended, and so does a stop that takes longer than it may,
        whatever has caused it; then the result is False.
        """
        due = time.monotonic()
        free_due = due + _FREE_MEMORY_S
        while not self._host.ended.is_set():
            if self._received_signal(due - time.monotonic()):
                if self._stopping and force:
                    return False
                self.stop()
            if force and self._host.stop_overdue:
                return False
            if time.monotonic() >= due:
                due = time.monotonic() + PERIOD_S
                self._host.publish_heartbeats()
            if time.monotonic() >= free_due:
                free_due = time.monotonic() + _FREE_MEMORY_S
                return_free_memory()
            on_turn()
        on_turn()
        return True

    def wake_up(self) -> None:
        """Have the next turn made at once; from any thread."""
        self._bell.ring()

    def stop(self) -> None:
        """Have the component shut down; starts in progress below it are cut short."""
        self._stopping = True
        self._host.expect_stop()
        self._host.terminate()

    @contextmanager
    def stop_signals(self, *numbers: signal.Signals) -> Iterator[None]:
        """Treat these signals as requests to stop."""
        with signal_handlers(numbers, self._on_signal):
            yield

    def _on_signal(self, number: int, _: FrameType | None) -> None:
        self._signals.append(number)
        self._bell.ring()

    def _received_signal(self, timeout_s: float) -> bool:
        if not self._signals:
            self._bell.wait(max(0.0, timeout_s))
        if not self._signals:
            return False
        self._signals.popleft()
        return True


class ComponentHost:
    """Constructs the component of a launch request and runs it on a thread of its own.

    It launches the children of a supervisor (`SupervisorHost`), and is the handle of a component
    that is placed in its supervisor's process (`ChildHandle`).
    """

    def __init__(self, launch: LaunchRequest, bus: ZenohBus) -> None:
        """Raises `CairnError` if the component cannot be constructed."""
        self.exit_report: ExitReport | None = None
        self.ended = threading.Event()
        self.on_exit: Callable[[], object] = self.ended.is_set
        self._name = launch.name
        self._parent = launch.parent
        self._bus = bus
        self._loop = ThreadLoop()
        self._loop_end: Future[ExitReport] = Future()  # done after the answer to its last call
        self._clock = PauseAwareClock()
        self._closed = False
        self._children: tuple[ComponentHost, ...] = ()  # those in this process
        self._starting: dict[str, ProcessHandle] = {}  # the last process of each child
        self._lock = threading.Lock()  # of what starts in the background share
        self._starts_canceled = False
        self._start_canceled = False  # its own
        self._zygote: ZygoteClient | None = None
        self._machines: RobotMachines | None = None
        context = launch.context
        self.runtime = Runtime(
            load_plugin(launch.spec.plugin),
            launch,
            bus,
            self._loop,
            SystemClock(),
            self._note_exit,
            self._clock.now,
            self._clock_problem,
        )
        if isinstance(self.runtime.component, Supervisor):
            self.runtime.component.adopt(launch, self)
        self._log_limit = LogLimit(self.runtime.log)
        self._rosout = RosoutHandler(self.runtime.node)
        self.runtime.log.addHandler(self._rosout)
        self._control = ControlServer(
            bus.session,
            context.domain,
            full_name(context.robot, launch.name),
            self._loop.post,
            self._answer_control,
            self.runtime.component.request_max_bytes,
            self.runtime.component.urgent_requests,
        )
        self._thread = threading.Thread(target=self._run, name=launch.name, daemon=True)

    def start(self) -> None:
        """Start to answer requests."""
        self._clock.start()
        self._thread.start()

    def post(self, call: Callable[[], None]) -> None:
        """Have `call` made as a handler of the component; from any thread."""
        self._loop.post(lambda: self.runtime.run("supervision", call))

    def now(self) -> float:
        """Return the monotonic time [s]."""
        return time.monotonic()

    def awake(self) -> float:
        """Return the monotonic time [s] in which this process could run."""
        return self._clock.now()

    def report_progress(self, step: str) -> None:
        """Report that a long call has reached its next step: it is not hung."""
        self.runtime.progress(step)

    def in_background(self, call: Callable[[], T]) -> Future[T]:
        """Make a call on a thread of its own."""
        result: Future[T] = Future()
        threading.Thread(
            target=complete, args=(result, call), name=f"{self._name} starts", daemon=True
        ).start()
        return result

    def launch_child(self, launch: LaunchRequest, on_exit: Callable[[], None]) -> ChildHandle:
        """Start a child and wait until it accepts requests; see `SupervisorHost`."""
        if launch.spec.placement == "in_process":
            host = ComponentHost(launch, self._bus)
            host.on_exit = on_exit
            with self._lock:
                running = (other for other in self._children if not other.ended.is_set())
                self._children = (*running, host)
            host.start()
            return host
        with self._lock:
            if self._zygote is None:
                self._zygote = ZygoteClient(
                    Path(launch.context.zygote),
                    lambda lost: self.runtime.log.critical("%s", lost),
                    lambda: self._starts_canceled,
                )
        handle = ProcessHandle(launch)
        with self._lock:
            self._starting[launch.name] = handle
        if self._starts_canceled:  # since the supervisor checked it; `handle` was not known yet
            raise CairnError("a stop was requested")
        handle.launch(self._zygote, on_exit)
        return handle

    def machines(self) -> RobotMachines:
        """Return what is known of the robot's other machines; see `SupervisorHost`."""
        with self._lock:
            if self._machines is None:
                context = self.runtime.launch.context
                self._machines = RobotMachines(
                    self._bus, self.runtime.node, context, self._clock.now
                )
            return self._machines

    def cancel_starts(self) -> None:
        """Have nothing started any more below, and cut short the starts in progress; any thread."""
        self._starts_canceled = True
        for child in self._children:
            child.expect_stop()
        for handle in tuple(self._starting.values()):
            handle.cancel_start()

    def cancel_start(self, name: str) -> None:
        """Cut short the start of a child."""
        if name in self._starting:
            self._starting[name].cancel_start()

    def send_request(self, verb: str, arguments: Mapping[str, Any] | None = None) -> Future[Any]:
        """Have a control request answered on the component's thread; return the future answer."""
        answer: Future[Any] = Future()

        def call() -> None:
            try:
                answer.set_result(self.runtime.request(verb, arguments or {}))
            except CairnError as error:
                answer.set_exception(error)

        self._loop.post(call)
        return answer

    def heartbeat(self) -> Heartbeat:
        """Return the state of the component and what it does now; from any thread."""
        status = self.runtime.status()
        return Heartbeat(
            LifecycleState(status.state), sendable(status.handler), max(0.0, status.handler_s)
        )

    def memory(self) -> int:
        """Return 0: its memory is that of this process, which its own supervisor watches."""
        return 0

    def is_stopped(self) -> bool:
        """Return False: it runs in this process, which runs."""
        return False

    def request(self, verb: str, timeout_s: float) -> Any:
        """Make a control request and return the answer.

        Raises `CairnError` if the component refuses, `ChildUnavailable` if it does not answer in
        time, or has ended and will not answer.
        """
        answer = self.send_request(verb)
        deadline = self._clock.now() + timeout_s  # which a pause of this process uses up in part
        while True:
            left_s = deadline - self._clock.now()
            step_s = max(0.0, min(left_s, PERIOD_S))
            done = wait_for((answer, self._loop_end), step_s, FIRST_COMPLETED).done
            if done or left_s <= 0:
                break
            if self._start_canceled and verb in ("configure", "activate"):
                raise CairnError("a stop was requested")
        if answer in done:
            return answer.result()
        if self._loop_end in done:
            raise ChildUnavailable(self._loop_end.result().reason)
        status = self.runtime.status()
        doing = f"; it is in {status.handler}" if status.handler else ""
        raise ChildUnavailable(f"no answer within {timeout_s:.1f} s{doing}")

    def expect_stop(self, limit_s: float | None = None) -> None:
        """Cut short starts in progress; see `ChildHandle` and `ChildGroup.request_stop`."""
        self._start_canceled = True
        if isinstance(self.runtime.component, Supervisor):
            self.runtime.component.children.request_stop(limit_s)

    @property
    def stop_overdue(self) -> bool:
        """Whether a supervisor takes longer to stop its children than it may; from any thread."""
        component = self.runtime.component
        return isinstance(component, Supervisor) and component.children.stop_overdue

    def terminate(self) -> None:
        """Ask the component to shut down."""
        self.send_request("shutdown")

    def kill(self, _: float) -> None:
        """Raise `CairnError`: a thread cannot be killed; its whole process has to end."""
        raise CairnError(
            f"{self._name}: it runs in its supervisor's process and cannot be killed; "
            "give it `placement: process`, or restart the supervisor"
        )

    def wait(self, timeout_s: float) -> ExitReport | None:
        """Wait for the end of the component, and leave the bus then; None if it still runs."""
        if not self.ended.wait(timeout_s):
            return None
        self.close()
        return self.exit_report

    def publish_heartbeats(self) -> None:
        """Publish the status of the component and of all below it in this process."""
        self.runtime.publish_heartbeat()
        self._log_limit.report()
        for child in self._children:
            child.publish_heartbeats()

    def close(self) -> None:
        """Wait for the end of the loop if it is ending, leave the bus, and kill all children."""
        if not self._closed:
            self._closed = True
            if self.ended.is_set():  # otherwise it hangs in a handler, and ends with the process
                self._thread.join(_JOIN_LIMIT_S)
            self._control.close()
            self._clock.close()
            self._log_limit.close()
            self.runtime.log.removeHandler(self._rosout)
        for child in self._children:
            child.close()
        if self._zygote is not None:
            self._zygote.close()

    def _clock_problem(self, machine: str) -> str:
        tolerance_s = self.runtime.launch.context.clock_tolerance_s
        offset = self.machines().clock_offset(machine)
        if offset is None or not offset.exceeds(tolerance_s):
            return ""
        return (
            f"it comes from machine {machine}: {offset}, more than clock_tolerance_s, "
            f"{tolerance_s:g} s; synchronize the clocks, see `cairn doctor`"
        )

    def _answer_control(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Answer a request from the bus; its supervisor alone may change the life cycle."""
        if verb in set(Transition):
            supervisor = self._parent or "its supervisor"
            raise CairnError(
                f"{self._name}: rejected {verb}: only its supervisor makes transitions of its life "
                f"cycle; request `hold` (name, state), `restart` or `unload` of {supervisor}"
            )
        return self.runtime.request(verb, arguments)

    def _run(self) -> None:
        try:
            self._loop.run()
        except BaseException as error:  # sys.exit() included: its process must not stay silent
            self._note_exit(ExitReport(False, f"its loop failed: {type(error).__name__}: {error}"))
            self.runtime.log.exception("component loop failed")
        finally:
            no_report = ExitReport(False, "its loop ended without a report")
            self._loop_end.set_result(self.exit_report or no_report)

    def _note_exit(self, report: ExitReport) -> None:
        self.exit_report = self.exit_report or report  # the first is the cause of the others
        self.ended.set()
        self.on_exit()


class PauseAwareClock:
    """Counts the seconds in which this process could run; a thread of its own observes that.

    Of a time in which that thread could not run only `PAUSE_S` count, whatever the cause: the
    machine paused, the process was stopped or got no processor, or a call let no other thread run.
    What waits or is waited for meanwhile does not hang. A component that lets no other thread run
    sends no heartbeats meanwhile, by which its supervisor finds it.
    """

    def __init__(self, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._monotonic = monotonic
        self._last = (0.0, monotonic())  # counted so far, and when; replaced as one
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="cairn clock", daemon=True)

    def start(self) -> None:
        """Start to observe."""
        self._thread.start()

    def now(self) -> float:
        """Return the time [s] since the start; from any thread."""
        counted_s, at = self._last
        return counted_s + min(self._monotonic() - at, PAUSE_S)

    def update(self) -> None:
        """Count the time since the last update; of a pause only `PAUSE_S`."""
        counted_s, at = self._last
        now = self._monotonic()
        self._last = (counted_s + min(now - at, PAUSE_S), now)

    def close(self) -> None:
        """Stop observing."""
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while not self._closed.wait(PERIOD_S):
            self.update()
