"""Hosts one component on a thread of this process: its loop, control requests and heartbeat."""

import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from contextlib import ExitStack
from typing import Any

from cairn.bus.bus import full_name
from cairn.bus.control import ControlServer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.clock import SystemClock
from cairn.deployment.plugins import load_plugin
from cairn.errors import CairnError
from cairn.placement.pause_aware_clock import PauseAwareClock
from cairn.process_exit import ExitReport
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.loop import ThreadLoop
from cairn.runtime.rosout import RosoutHandler
from cairn.runtime.runtime import Runtime
from cairn.supervision.child import ChildUnavailable
from cairn.supervision.supervisor import Supervisor

_JOIN_LIMIT_S = 5.0


class ComponentHost:
    """Constructs the component of a launch request and runs it on a thread of its own."""

    def __init__(self, launch: LaunchRequest, bus: ZenohBus) -> None:
        """Raises `CairnError` if the component cannot be constructed."""
        self.launch = launch
        self.bus = bus
        self.exit_report: ExitReport | None = None
        self.ended = threading.Event()
        self.on_exit: Callable[[], object] = self.ended.is_set
        self.children: tuple[ComponentHost, ...] = ()  # those in this process
        self.resources = ExitStack()  # closed with the host
        self._loop = ThreadLoop()
        self._clock = PauseAwareClock()
        self._closed = False
        context = launch.context
        self.runtime = Runtime(
            load_plugin(launch.spec.plugin),
            launch,
            bus,
            self._loop,
            SystemClock(),
            self._note_exit,
            self._clock.now,
        )
        self._rosout = RosoutHandler(self.runtime.node)
        self.runtime.log.addHandler(self._rosout)
        self._control = ControlServer(
            bus.session,
            context.domain,
            full_name(context.robot, launch.name),
            self._loop.post,
            self.runtime.request,
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
        """Return the monotonic time [s] without pauses of the machine."""
        return self._clock.now()

    def report_progress(self, step: str) -> None:
        """Report that a long call has reached its next step: it is not hung."""
        self.runtime.progress(step)

    def send_request(self, verb: str, arguments: Mapping[str, Any] | None = None) -> "Future[Any]":
        """Have a control request answered on the component's thread; return the future answer."""
        answer: Future[Any] = Future()

        def call() -> None:
            try:
                answer.set_result(self.runtime.request(verb, arguments or {}))
            except CairnError as error:
                answer.set_exception(error)

        self._loop.post(call)
        return answer

    def request(self, verb: str, timeout_s: float) -> Any:
        """Make a control request and return the answer.

        Raises `CairnError` if the component refuses, `ChildUnavailable` if it does not answer in
        time.
        """
        try:
            return self.send_request(verb).result(timeout_s)
        except FutureTimeout:
            status = self.runtime.status()
            doing = f"; it is in {status.handler}" if status.handler else ""
            raise ChildUnavailable(
                f"{self.launch.name} did not answer {verb} within {timeout_s:.1f} s{doing}"
            ) from None

    def request_stop(self) -> None:
        """Have nothing started any more below, and cut short the start in progress; any thread."""
        if isinstance(self.runtime.component, Supervisor):
            self.runtime.component.children.request_stop()

    def publish_heartbeats(self) -> None:
        """Publish the status of the component and of all below it in this process."""
        self.runtime.heartbeat.publish()
        for child in self.children:
            child.publish_heartbeats()

    def close(self) -> None:
        """Wait for the end of the loop if it is ending, leave the bus, and kill all children."""
        if not self._closed:
            self._closed = True
            if self.ended.is_set():  # otherwise it hangs in a handler, and ends with the process
                self._thread.join(_JOIN_LIMIT_S)
            self._control.close()
            self._clock.close()
            self.runtime.log.removeHandler(self._rosout)
        for child in self.children:
            child.close()
        self.resources.close()

    def _run(self) -> None:
        try:
            self._loop.run()
        except BaseException as error:  # sys.exit() included: its process must not stay silent
            self._note_exit(ExitReport(False, f"its loop failed: {type(error).__name__}: {error}"))
            self.runtime.log.exception("component loop failed")

    def _note_exit(self, report: ExitReport) -> None:
        self.exit_report = self.exit_report or report  # the first is the cause of the others
        self.ended.set()
        self.on_exit()
