"""A component's own process: its main function, and the loop of its main thread."""

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
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

from cairn.bus.session import open_peer, peer_socket
from cairn.bus.zenoh_bus import ZenohBus
from cairn.errors import CairnError
from cairn.processes.child_channel import (
    ChildChannel,
    Request,
    StopAhead,
    TransitionAnswer,
    sendable,
)
from cairn.processes.component_host import ComponentHost
from cairn.processes.launcher import TRACEBACK_SIGNAL
from cairn.processes.prepared import CODEC
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.log_output import OutputFile, OutputHandler
from cairn.system.bell import Bell
from cairn.system.heap import return_free_memory
from cairn.system.process_exit import ExitReport, end_process, log_reason
from cairn.system.signal_handlers import signal_handlers

HEARTBEAT_S = 0.25
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
    stops another child.
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

    def answer(request: Request, made: "Future[Any]") -> None:
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
                due = time.monotonic() + HEARTBEAT_S
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
