"""Children that behave as a test says, on a clock that moves only when they say so."""

from collections.abc import Callable
from dataclasses import dataclass, field

from cairn import CairnError
from cairn.supervision.child import Accident, ChildEnd, ChildRules, Verb
from cairn.supervision.events import SupervisionEvent
from cairn.supervision.policy import Intensity, Strategy
from cairn.supervision.supervisor import Supervisor

Step = Callable[["ScriptedChild", float], None]  # called with the step's time limit [s]


def fails(reason: str) -> Step:
    def step(child: "ScriptedChild", timeout_s: float) -> None:
        raise CairnError(reason)

    return step


def does_not_answer(child: "ScriptedChild", timeout_s: float) -> None:
    child.world.now_s += timeout_s
    raise Accident(f"{child.name} did not answer within {timeout_s:g} s")


def takes(seconds: float) -> Step:
    def step(child: "ScriptedChild", timeout_s: float) -> None:
        child.world.now_s += seconds

    return step


def dies(reason: str) -> Step:
    def step(child: "ScriptedChild", timeout_s: float) -> None:
        child.end = ChildEnd(False, reason)
        raise Accident(f"{child.name} {reason}")

    return step


def is_ignored(child: "ScriptedChild", timeout_s: float) -> None:
    """Neither answers nor ends, as a process without handler for SIGTERM would not."""


def ends(child: "ScriptedChild", timeout_s: float) -> None:
    child.end = ChildEnd(True, "ended with exit code 0")


def is_killed(child: "ScriptedChild", timeout_s: float) -> None:
    child.end = ChildEnd(False, "was killed by SIGKILL")


@dataclass
class ScriptedChild:
    """Does at each step what its script says, else what a good component does."""

    world: "World"
    name: str
    incarnation: int
    script: dict[str, Step]
    end: ChildEnd | None = None

    def request(self, verb: Verb, timeout_s: float) -> None:
        self._step(verb, timeout_s, ends if verb == "shutdown" else is_ignored)

    def terminate(self) -> None:
        self._step("terminate", 0.0, ends)

    def kill(self) -> None:
        self._step("kill", 0.0, is_killed)

    def wait(self, timeout_s: float) -> ChildEnd | None:
        if self.end is None:
            self.world.now_s += timeout_s
        return self.end

    def _step(self, what: str, timeout_s: float, usual: Step) -> None:
        self.world.steps.append(f"{what} {self.name}")
        self.script.get(what, usual)(self, timeout_s)


@dataclass
class World:
    """The launcher, the clock, and all that happened."""

    now_s: float = 100.0
    scripts: dict[str, list[dict[str, Step]]] = field(default_factory=dict)
    children: dict[str, ScriptedChild] = field(default_factory=dict)
    steps: list[str] = field(default_factory=list)
    events: list[SupervisionEvent] = field(default_factory=list)
    progress: list[tuple[str, float]] = field(default_factory=list)
    on_step: Callable[[str], None] = lambda text: None

    def script(self, name: str, *incarnations: dict[str, Step]) -> None:
        """What a child does at each step, by incarnation; further ones do well."""
        self.scripts[name] = list(incarnations)

    def launch(self, spec: ChildRules, incarnation: int, previous_exit: str) -> ScriptedChild:
        self.steps.append(f"launch {spec.name}")
        scripts = self.scripts.get(spec.name, [])
        script = scripts[incarnation - 1] if incarnation <= len(scripts) else {}
        child = ScriptedChild(self, spec.name, incarnation, script)
        if "launch" in script:
            script["launch"](child, spec.start_timeout_s)
        self.children[spec.name] = child
        return child

    def take_steps(self) -> list[str]:
        """The steps since the last call."""
        steps, self.steps = self.steps, []
        return steps

    def told(self, child: str) -> list[tuple[str, str]]:
        return [(event.what, event.reason) for event in self.events if event.child == child]

    def running(self) -> list[str]:
        return [name for name, child in self.children.items() if child.end is None]

    def supervisor(
        self,
        *children: ChildRules | str,
        strategy: Strategy = "one_for_one",
        intensity: Intensity | None = None,
    ) -> Supervisor:
        def progress(text: str, limit_s: float) -> None:
            self.progress.append((text, limit_s))
            self.on_step(text)

        return Supervisor(
            "mobile_supervisor",
            [ChildRules(child) if isinstance(child, str) else child for child in children],
            self,
            observe=self.events.append,
            progress=progress,
            strategy=strategy,
            intensity=intensity,
            now=lambda: self.now_s,
        )
