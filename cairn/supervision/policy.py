"""Decides whom to stop and start when a child ends: the supervision of Erlang/OTP, without I/O."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from cairn.errors import CairnError

Restart = Literal["permanent", "transient", "temporary"]
Strategy = Literal["one_for_one", "rest_for_one", "one_for_all"]


class UnknownChild(CairnError):  # noqa: N818 - reads as what happened
    """A supervisor has no child of that name."""


@dataclass(frozen=True)
class ChildPolicy:
    """When a child is restarted, and whether its normal end ends its supervisor."""

    name: str
    restart: Restart = "permanent"
    significant: bool = False


@dataclass(frozen=True)
class Intensity:
    """How many restarts are allowed within how many seconds; one more makes a supervisor fail."""

    max_restarts: int = 3
    within_s: float = 10.0


@dataclass(frozen=True)
class Decision:
    """Children to stop, in that order, as far as they run; then children to start, in order.

    `give_up` and `finished` are reasons ("" if not so): everything is stopped, and the supervisor
    itself has failed or ended normally.
    """

    stop: tuple[str, ...] = ()
    start: tuple[str, ...] = ()
    give_up: str = ""
    finished: str = ""


class Policy:
    """Which children of a supervisor should run.

    As in OTP's `supervisor`: a permanent child is always restarted, a transient one after an
    abnormal end, a temporary one never, not even with its siblings; a transient child that has
    ended normally starts again when its siblings are restarted; a restart that fails is one more
    restart; a child that says at its first start that it cannot makes the supervisor fail at once.
    Beyond OTP: such a temporary child is left alone; the normal end of any significant child
    finishes the supervisor, the abnormal one of a significant temporary child makes it fail, and so
    does a child that fails to start more than `max_restarts` times on end, be its attempts as slow
    as they may.
    """

    def __init__(
        self,
        children: Sequence[ChildPolicy],
        strategy: Strategy = "one_for_one",
        intensity: Intensity | None = None,
    ) -> None:
        """Children in start order, none of them to run yet. Raises `ValueError` for twins."""
        self._children = {child.name: child for child in children}
        if len(self._children) != len(children):
            raise ValueError("two children of a supervisor have the same name")
        self._order = tuple(self._children)
        self._strategy = strategy
        self.intensity = intensity or Intensity()
        self._wanted: set[str] = set()
        self._done: set[str] = set()  # transient, ended normally
        self._restarts: deque[float] = deque()
        self._failed_starts: dict[str, int] = dict.fromkeys(self._order, 0)
        self._tried: set[str] = set()

    @property
    def wanted(self) -> tuple[str, ...]:
        """The children that should run, in start order."""
        return tuple(name for name in self._order if name in self._wanted)

    def load(self, name: str) -> Decision:
        """A child is to run from now on. Raises `UnknownChild`."""
        self._check(name)
        if name in self._wanted:
            return Decision()
        self._done.discard(name)
        self._wanted.add(name)
        self._failed_starts[name] = 0
        return Decision(start=(name,))

    def unload(self, name: str) -> Decision:
        """A child is not to run any more, whatever its siblings do. Raises `UnknownChild`."""
        self._check(name)
        self._done.discard(name)
        if name not in self._wanted:
            return Decision()
        self._wanted.discard(name)
        return Decision(stop=(name,))

    def restart(self, name: str) -> Decision:
        """A child is to start anew, alone, by order and not counted. Raises `UnknownChild`."""
        stop = self.unload(name).stop
        return Decision(stop=stop, start=self.load(name).start)

    def started(self, name: str) -> None:
        """A child has become active."""
        self._failed_starts[name] = 0
        self._tried.add(name)

    def ended(self, name: str, *, normal: bool, at_s: float, reason: str) -> Decision:
        """A child that should run ended, or failed to start (not normal), at this time [s]."""
        self._check(name)
        if name not in self._wanted:
            return Decision()
        child = self._children[name]
        if child.significant and (normal or child.restart == "temporary"):
            if not normal:
                return self._given_up(f"{name} failed and is not restarted: {reason}")
            others = tuple(reversed(self.wanted))
            self._wanted.clear()
            return Decision(stop=others, finished=f"{name} has finished: {reason}")
        if child.restart == "temporary" or (child.restart == "transient" and normal):
            self._wanted.discard(name)
            if child.restart == "transient":
                self._done.add(name)
            return Decision()
        return self._restart_after(name, at_s, reason)

    def start_failed(self, name: str, *, at_s: float, reason: str, accident: bool) -> Decision:
        """A child that should run did not become active: an abnormal end, counted on end.

        `accident`: it was killed or did not answer; else it said so itself, and will say it again.
        """
        self._check(name)
        first = name not in self._tried
        self._tried.add(name)
        self._failed_starts[name] += 1
        hopeless = first and not accident and self._children[name].restart != "temporary"
        if hopeless and name in self._wanted:
            return self._given_up(f"{name}: {reason}")
        return self.ended(name, normal=False, at_s=at_s, reason=reason)

    def _given_up(self, why: str) -> Decision:
        others = tuple(reversed(self.wanted))
        self._wanted.clear()
        return Decision(stop=others, give_up=why)

    def _restart_after(self, name: str, at_s: float, reason: str) -> Decision:
        exceeded = self._exceeded(name, at_s)
        if exceeded:
            return self._given_up(f"{exceeded}; last, {name}: {reason}")
        group = self._group(name)
        stop = tuple(other for other in reversed(self.wanted) if other in group)
        for other in group - {name}:
            if self._children[other].restart == "temporary":
                self._wanted.discard(other)
            elif other in self._done:
                self._wanted.add(other)
        self._done -= group
        start = tuple(other for other in self.wanted if other in group)
        return Decision(stop=tuple(other for other in stop if other != name), start=start)

    def _exceeded(self, name: str, at_s: float) -> str:
        allowed, within_s = self.intensity.max_restarts, self.intensity.within_s
        self._restarts.append(at_s)
        while at_s - self._restarts[0] > within_s:
            self._restarts.popleft()
        if len(self._restarts) > allowed:
            return f"given up after more than {allowed} restarts within {within_s:g} s"
        if self._failed_starts[name] > allowed:
            return f"given up after {self._failed_starts[name]} failed starts on end"
        return ""

    def _group(self, name: str) -> set[str]:
        """The children that share the fate of this one, itself included."""
        match self._strategy:
            case "one_for_one":
                return {name}
            case "rest_for_one":
                return set(self._order[self._order.index(name) :])
            case "one_for_all":
                return set(self._order)

    def _check(self, name: str) -> None:
        if name not in self._children:
            known = ", ".join(self._order) or "none"
            raise UnknownChild(f"there is no child {name} here, but: {known}")
