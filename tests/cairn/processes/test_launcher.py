"""Processes of components that cannot be killed, or log their stacks late: an injected zygote."""

import faulthandler
import os
import re
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from cairn.errors import Escalate
from cairn.processes.child import ChildHandle
from cairn.processes.child_channel import ChildChannel, Heartbeat, Request, TransitionAnswer
from cairn.processes.component_process import log_stacks_on_signal
from cairn.processes.launcher import TRACEBACK_SIGNAL, ChildProcess, ProcessHandle
from cairn.processes.supervisor import ChildGroup
from cairn.processes.zygote import Exited, Signal
from cairn.runtime.child_spec import ChildSpec
from cairn.runtime.launch_request import LaunchRequest, RunContext
from cairn.runtime.lifecycle import LifecycleState
from tests.cairn.processes.scripted_children import World
from tests.patience import LIMIT_S
from tests.wording import words_in_order

pytestmark = pytest.mark.processes


class UnkillableProcess(ChildProcess):
    """Does not join the bus, and does not end, as if it were in uninterruptible sleep."""

    def __init__(self, world: "UnkillableWorld", log: Path) -> None:
        super().__init__(0, lambda _: self._log_stacks())
        self._world = world
        self._log = log

    def wait(self, timeout_s: float) -> Exited | None:
        self._world.now_s += timeout_s
        return None

    def _log_stacks(self) -> None:
        with self._log.open("a") as log:
            log.write("Thread 0x1 (most recent call first):\n")


class UnkillableWorld(World):
    """Launches such processes; it is the zygote as well."""

    def __init__(self) -> None:
        super().__init__()
        self.spawned = 0

    def launch_child(  # type: ignore[override]  # a process, not a scripted child
        self, launch: LaunchRequest, on_exit: Callable[[], None]
    ) -> ChildHandle:
        handle = ProcessHandle(launch)
        handle.launch(self, on_exit)  # type: ignore[arg-type]  # only `spawn` is called
        return handle

    def spawn(self, name: str, entry: str, argument: Any, log: Path, **_: Any) -> ChildProcess:
        self.spawned += 1
        return UnkillableProcess(self, log)


def test_process_that_neither_joins_the_bus_nor_can_be_killed_is_not_started_twice(
    tmp_path: Path,
) -> None:
    world = UnkillableWorld()
    child = ChildSpec(plugin=f"{__name__}:Unused", interpreter="fresh", start_timeout_s=0.05)
    launch = LaunchRequest(
        name="root",
        spec=ChildSpec(plugin="supervisor", children={"base": child}),
        context=RunContext(log_folder=str(tmp_path)),
    )
    supervisor = ChildGroup(launch, world, world.log.logger, on_exit=lambda: None)

    with pytest.raises(Escalate, match=words_in_order("base", "not active", "killed", "device")):
        supervisor.start_all()

    assert world.spawned == 1


class EndingProcess(ChildProcess):
    """Answers each request, until its component has ended; it ends when it is waited for."""

    def __init__(self) -> None:
        super().__init__(1, lambda _: None)
        self._channel: ChildChannel
        self._thread = threading.Thread(target=self._serve)

    def spawn(self, *_: Any, channel: socket.socket, **__: Any) -> ChildProcess:
        self._channel = ChildChannel(channel.dup())
        self._channel.send_heartbeat(lambda: Heartbeat(LifecycleState.UNCONFIGURED))
        self._thread.start()
        return self

    def end_component(self) -> None:
        """Do what `component_process` does first when its component has ended."""
        self._channel.stop_receiving()
        self._thread.join(LIMIT_S)

    def wait(self, timeout_s: float) -> Exited | None:
        if timeout_s > 0 and not self._thread.is_alive() and not self.exit.done():
            self.exit.set_result(Exited(self.pid, 0))
        return super().wait(0)

    def _serve(self) -> None:
        while isinstance(request := self._channel.receive(), Request):
            self._channel.send_answer(TransitionAnswer(request.number))


class EndingWorld(World):
    """Launches that process."""

    def __init__(self) -> None:
        super().__init__()
        self.process = EndingProcess()

    def launch_child(  # type: ignore[override]  # a process, not a scripted child
        self, launch: LaunchRequest, on_exit: Callable[[], None]
    ) -> ChildHandle:
        handle = ProcessHandle(launch)
        handle.launch(self.process, on_exit)  # type: ignore[arg-type]  # only `spawn` is called
        return handle


def test_stop_of_a_child_that_has_just_ended_by_itself_is_clean(tmp_path: Path) -> None:
    world = EndingWorld()
    child = ChildSpec(plugin=f"{__name__}:Unused", interpreter="fresh")
    launch = LaunchRequest(
        name="root",
        spec=ChildSpec(plugin="supervisor", children={"base": child}),
        context=RunContext(log_folder=str(tmp_path)),
    )
    supervisor = ChildGroup(launch, world, world.log.logger, on_exit=lambda: None)
    supervisor.start_all()
    world.process.end_component()

    supervisor.stop_all()

    supervisor.check_stops()
    assert not [line for line in world.log.lines if "stop failed" in line]


class BusyProcess(ChildProcess):
    """Logs its stacks a while after it is asked to; `killed_with` is its log when it is killed."""

    def __init__(self, log: Path) -> None:
        super().__init__(os.getpid(), self._receive)
        self.received: list[int] = []
        self.killed_with = ""
        self._log = log

    def spawn(self, *_: Any, **__: Any) -> ChildProcess:
        return self

    def _receive(self, request: Signal) -> None:
        self.received.append(request.signal)
        if request.signal == TRACEBACK_SIGNAL:
            self._log.write_text("a warning\n")
            threading.Timer(1.0, self._log_stacks).start()
        elif request.signal == signal.SIGKILL:
            self.killed_with = self._log.read_text() if self._log.exists() else ""

    def _log_stacks(self) -> None:
        self._log.write_text("Thread 0x1 (most recent call first):\n  in tick\n")


@pytest.fixture
def busy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[BusyProcess, ProcessHandle]:
    monkeypatch.setattr("cairn.processes.launcher._LEAVING_LIMIT_S", 0.0)
    monkeypatch.setattr("cairn.processes.launcher._KILL_LIMIT_S", 0.0)
    launch = LaunchRequest(
        name="base",
        spec=ChildSpec(plugin=f"{__name__}:Unused", interpreter="fresh", start_timeout_s=0.05),
        context=RunContext(log_folder=str(tmp_path)),
    )
    process = BusyProcess(tmp_path / "base.log")
    handle = ProcessHandle(launch)
    handle.launch(process, lambda: None)  # type: ignore[arg-type]  # only `spawn` is called
    process.received.clear()
    return process, handle


@pytest.fixture
def handles_signal() -> Iterator[None]:
    """This process, which stands for the busy one, logs its stacks on the signal."""
    before = signal.getsignal(TRACEBACK_SIGNAL)
    log_stacks_on_signal()
    yield
    faulthandler.unregister(TRACEBACK_SIGNAL)
    signal.signal(TRACEBACK_SIGNAL, before)


@pytest.mark.usefixtures("handles_signal")
def test_hung_process_is_killed_when_its_stacks_are_logged(
    busy: tuple[BusyProcess, ProcessHandle],
) -> None:
    process, handle = busy

    handle.kill(LIMIT_S)

    assert "in tick" in process.killed_with


def test_process_that_has_just_started_or_ends_is_killed_by_no_other_signal(
    busy: tuple[BusyProcess, ProcessHandle],
) -> None:
    process, handle = busy

    handle.kill(LIMIT_S)

    assert process.received == [signal.SIGKILL]


@pytest.mark.usefixtures("handles_signal")
def test_signal_for_stacks_is_ignored_when_python_has_removed_its_handler() -> None:
    faulthandler.unregister(TRACEBACK_SIGNAL)

    status = Path("/proc/self/status").read_text(encoding="ascii")
    ignored = int(re.findall(r"^SigIgn:\s+(\w+)", status, re.MULTILINE)[0], 16)
    assert ignored >> (TRACEBACK_SIGNAL - 1) & 1
