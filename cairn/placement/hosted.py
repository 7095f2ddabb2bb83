"""One component hosted on a thread of this process: its loop, its control, its heartbeat."""

import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from typing import Any

from cairn.bus.bus import full_name
from cairn.bus.control import ControlServer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.clock import SystemClock
from cairn.deployment.plugins import load_plugin
from cairn.errors import CairnError
from cairn.placement.awake import AwakeTime
from cairn.process_exit import ExitReport
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.loop import ThreadLoop
from cairn.runtime.rosout import RosoutHandler
from cairn.runtime.runtime import Runtime
from cairn.supervision.child import Accident

JOIN_LIMIT_S = 5.0


class Hosted:
    """Constructs the component of an order and runs it on a thread of its own."""

    def __init__(self, order: LaunchRequest, bus: ZenohBus) -> None:
        """Raises `CairnError` if the component cannot be constructed."""
        self.order = order
        self.bus = bus
        self.end: ExitReport | None = None
        self.ended = threading.Event()
        self.on_end: Callable[[], object] = self.ended.is_set
        self._loop = ThreadLoop()
        self._awake = AwakeTime()
        self._closed = False
        context = order.context
        self.runtime = Runtime(
            load_plugin(order.spec.plugin),
            order,
            bus,
            self._loop,
            SystemClock(),
            self._note_end,
            self._awake.now,
        )
        self._rosout = RosoutHandler(self.runtime.node)
        self.runtime.log.addHandler(self._rosout)
        self._control = ControlServer(
            bus.session,
            context.domain,
            full_name(context.robot, order.name),
            self._loop.post,
            self.runtime.request,
        )
        self._thread = threading.Thread(target=self._run, name=order.name, daemon=True)

    def start(self) -> None:
        """Begin to answer requests."""
        self._awake.start()
        self._thread.start()

    def post(self, call: Callable[[], None]) -> None:
        """Have `call` made as a handler of the component; from any thread."""
        self._loop.post(lambda: self.runtime.run("supervision", call))

    def now(self) -> float:
        """Time [s] since some moment, that nobody sets."""
        return time.monotonic()

    def awake(self) -> float:
        """Time [s] since some moment, without that in which the machine paused."""
        return self._awake.now()

    def progress(self, what: str) -> None:
        """Say that a long call gets on."""
        self.runtime.progress(what)

    def ask(self, verb: str, arguments: Mapping[str, Any] | None = None) -> "Future[Any]":
        """Have a control request answered on the component's thread."""
        answer: Future[Any] = Future()

        def make() -> None:
            try:
                answer.set_result(self.runtime.request(verb, arguments or {}))
            except CairnError as error:
                answer.set_exception(error)

        self._loop.post(make)
        return answer

    def request(self, verb: str, timeout_s: float) -> Any:
        """Wait for the answer; `CairnError` if the request is refused, `Accident` if none comes."""
        try:
            return self.ask(verb).result(timeout_s)
        except FutureTimeout:
            status = self.runtime.status()
            doing = f"; it is in {status.handler}" if status.handler else ""
            raise Accident(
                f"{self.order.name} did not answer {verb} within {timeout_s:.1f} s{doing}"
            ) from None

    def close(self) -> None:
        """Wait for the loop's end if it is under way, and leave the bus."""
        if self._closed:
            return
        self._closed = True
        if self.ended.is_set():  # else it hangs in a handler, and ends with the process
            self._thread.join(JOIN_LIMIT_S)
        self._control.close()
        self._awake.close()
        self.runtime.log.removeHandler(self._rosout)

    def _run(self) -> None:
        try:
            self._loop.run()
        except BaseException as error:  # sys.exit() included: no mute process is left behind
            self._note_end(ExitReport(False, f"its loop failed: {type(error).__name__}: {error}"))
            self.runtime.log.exception("the component's loop failed")

    def _note_end(self, end: ExitReport) -> None:
        self.end = self.end or end  # the first cause, not what followed from it
        self.ended.set()
        self.on_end()
