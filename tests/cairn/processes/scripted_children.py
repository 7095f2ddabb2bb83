"""Children that behave as scripted by a test, on a clock that only they advance."""

import logging
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import TypeVar

from cairn import CairnError
from cairn.processes.child import ChildUnavailable, complete, completed
from cairn.processes.child_channel import Heartbeat, Verb
from cairn.processes.remote_child import Machines
from cairn.processes.supervisor import ChildGroup
from cairn.runtime.child_spec import ChildSpec, Supervision
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.lifecycle import STATE_AFTER, LifecycleState
from cairn.runtime.process_exit import ExitReport

T = TypeVar("T")

_READY = Heartbeat(LifecycleState.UNCONFIGURED)
Step = Callable[["ScriptedChild", float], None]  # called with the step's time limit [s]


def fails(reason: str) -> Step:
    def step(child: "ScriptedChild", timeout_s: float) -> None:
        raise CairnError(reason)

    return step


def does_not_answer(child: "ScriptedChild", timeout_s: float) -> None:
    child.world.now_s += timeout_s
    raise ChildUnavailable(f"{child.name} did not answer within {timeout_s:g} s")


def takes(seconds: float) -> Step:
    def step(child: "ScriptedChild", timeout_s: float) -> None:
        child.world.now_s += seconds

    return step


def dies(reason: str) -> Step:
    def step(child: "ScriptedChild", timeout_s: float) -> None:
        child.end = ExitReport(False, reason)
        raise ChildUnavailable(f"{child.name} {reason}")

    return step


def is_ignored(child: "ScriptedChild", timeout_s: float) -> None:
    """Neither answers nor ends, as a process without handler for SIGTERM would not."""


def ends(child: "ScriptedChild", timeout_s: float) -> None:
    child.end = ExitReport(True, "exit code 0")


def is_killed(child: "ScriptedChild", timeout_s: float) -> None:
    child.end = ExitReport(False, "killed by SIGKILL (signal 9)")


@dataclass
class ScriptedChild:
    """Does at each step what its script specifies, by default what a correct component does."""

    world: "World"
    name: str
    incarnation: int
    script: dict[str, Step]
    end: ExitReport | None = None
    state: LifecycleState = LifecycleState.UNCONFIGURED
    sent: Heartbeat | None = _READY  # that was not read yet
    garbage: str = ""
    stopped: bool = False
    memory_bytes: int = 0

    def request(self, verb: Verb, timeout_s: float) -> None:
        self.world.limits.append((f"{verb} {self.name}", timeout_s))
        self._step(verb, timeout_s, ends if verb == "shutdown" else is_ignored)
        self.state = STATE_AFTER.get(verb, LifecycleState.FINALIZED)
        self.sent = Heartbeat(self.state)

    def beat(self, handler: str = "", handler_s: float = 0.0) -> None:
        """Send a heartbeat: the child is within that handler for so many seconds."""
        self.sent = Heartbeat(self.state, handler, handler_s)

    def heartbeat(self) -> Heartbeat | None:
        if self.garbage:
            raise ChildUnavailable(self.garbage)
        sent, self.sent = self.sent, None
        return sent

    def is_stopped(self) -> bool:
        return self.stopped

    def memory(self) -> int:
        return self.memory_bytes

    def expect_stop(self, limit_s: float) -> None:
        self.world.limits.append((f"expect_stop {self.name}", limit_s))

    def terminate(self) -> None:
        self._step("terminate", 0.0, ends)

    def kill(self, log_limit_s: float) -> None:
        self._step("kill", 0.0, is_killed)

    def wait(self, timeout_s: float) -> ExitReport | None:
        if self.end is None:
            self.world.now_s += timeout_s
        return self.end

    def _step(self, step: str, timeout_s: float, usual: Step) -> None:
        self.world.steps.append(f"{step} {self.name}")
        self.script.get(step, usual)(self, timeout_s)


class Log(logging.Handler):
    """What a supervisor has logged: each line with its level."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []
        self.logger = logging.Logger("supervisor", logging.DEBUG)
        self.logger.addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(f"{record.levelname} {record.getMessage()}")


@dataclass
class World:
    """The host of a supervisor: launcher, clock, and a record of all steps."""

    now_s: float = 100.0
    scripts: dict[str, list[dict[str, Step]]] = field(default_factory=dict)
    children: dict[str, ScriptedChild] = field(default_factory=dict)
    steps: list[str] = field(default_factory=list)
    limits: list[tuple[str, float]] = field(default_factory=list)  # of each request [s]
    log: Log = field(default_factory=Log)
    progress: list[str] = field(default_factory=list)
    stop_requests: int = 0
    on_step: Callable[[str], None] = lambda text: None
    robot_machines: Machines | None = None
    slow_starts: bool = False
    """Whether starts are held back until `finish_starts`."""
    pending: list[Callable[[], None]] = field(default_factory=list)
    posted: list[Callable[[], None]] = field(default_factory=list)

    def script(self, name: str, *incarnations: dict[str, Step]) -> None:
        """Set what a child does at each step, by incarnation; later ones are correct."""
        self.scripts[name] = list(incarnations)

    def launch_child(self, launch: LaunchRequest, on_exit: Callable[[], None]) -> ScriptedChild:
        name = launch.name
        self.steps.append(f"launch {name}")
        scripts = self.scripts.get(name, [])
        script = scripts[launch.incarnation - 1] if launch.incarnation <= len(scripts) else {}
        child = ScriptedChild(self, name, launch.incarnation, script)
        if "launch" in script:
            script["launch"](child, launch.spec.start_limit_s)
        self.children[name] = child
        return child

    def in_background(self, call: Callable[[], T]) -> "Future[T]":
        if not self.slow_starts:
            return completed(call)
        result: Future[T] = Future()
        self.pending.append(lambda: complete(result, call))
        return result

    def finish_starts(self) -> None:
        """Make the starts that were held back by `slow_starts`."""
        pending, self.pending = self.pending, []
        for start in pending:
            start()

    def machines(self) -> Machines:
        assert self.robot_machines is not None
        return self.robot_machines

    def cancel_starts(self) -> None:
        self.stop_requests += 1

    def cancel_start(self, name: str) -> None:
        self.steps.append(f"cancel start {name}")
        self.finish_starts()

    def now(self) -> float:
        return self.now_s

    def awake(self) -> float:
        return self.now_s

    def post(self, call: Callable[[], None]) -> None:
        self.posted.append(call)

    def report_progress(self, step: str) -> None:
        self.progress.append(step)
        self.on_step(step)

    def take_steps(self) -> list[str]:
        """Return the steps since the last call."""
        steps, self.steps = self.steps, []
        return steps

    def running(self) -> list[str]:
        return [name for name, child in self.children.items() if child.end is None]

    def supervisor(self, *names: str, **children: ChildSpec) -> ChildGroup:
        """Return the children of a supervisor: those named, then those specified."""
        return self.supervisor_with(Supervision(), *names, **children)

    def supervisor_with(
        self, supervision: Supervision, *names: str, **children: ChildSpec
    ) -> ChildGroup:
        specs = {name: ChildSpec(plugin="test") for name in names} | children
        spec = ChildSpec(plugin="supervisor", supervision=supervision, children=specs)
        launch = LaunchRequest(name="mobile_supervisor", spec=spec)
        return ChildGroup(launch, self, self.log.logger, on_exit=lambda: None)
