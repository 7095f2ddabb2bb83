"""Decides which children of a supervisor stop and start when one ends (as Erlang/OTP); no I/O."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from cairn.runtime.child_spec import ChildSpec, Supervision


@dataclass(frozen=True)
class RestartDecision:
    """Children to stop, in that order, as far as they run; then children to start, in order.

    `give_up` and `finished` are reasons, "" if not so: all children have to stop, and the
    supervisor itself fails (`give_up`) or ends normally (`finished`).
    """

    stop: tuple[str, ...] = ()
    start: tuple[str, ...] = ()
    give_up: str = ""
    finished: str = ""


class RestartPolicy:
    """Which children of a supervisor should run.

    As in OTP's `supervisor`: a permanent child is always restarted, a transient one after an
    abnormal end, a temporary one never, not even with its siblings. A transient child that has
    ended normally starts again when its siblings are restarted. A restart that fails counts as
    another restart. A child that refuses to start the first time makes the supervisor fail at once.

    Beyond OTP: a temporary child that refuses to start is left alone. The normal end of any
    significant child finishes the supervisor, and the abnormal end of a significant temporary child
    makes it fail. So does a child that fails to start more than `max_restarts` times in a row,
    however slow its attempts are.
    """

    def __init__(self, children: Mapping[str, ChildSpec], supervision: Supervision) -> None:
        """Take the children in start order; none of them should run yet."""
        self.supervision = supervision
        self._children = dict(children)
        self._order = tuple(children)
        self._required: set[str] = set()
        self._done: set[str] = set()  # transient children that ended normally
        self._restart_times: deque[float] = deque()
        self._failed_starts = dict.fromkeys(self._order, 0)  # in a row
        self._attempted: set[str] = set()  # children that were started before, with success or not

    @property
    def required(self) -> tuple[str, ...]:
        """The children that should run, in start order."""
        return tuple(name for name in self._order if name in self._required)

    @property
    def restart_count(self) -> str:
        """The number of the last restart, such as "2 of 3 restarts in 10 s"."""
        limits = self.supervision
        return (
            f"{len(self._restart_times)} of {limits.max_restarts} restarts in {limits.within_s:g} s"
        )

    def load(self, name: str) -> None:
        """Have a child run from now on."""
        if name not in self._required:
            self._done.discard(name)
            self._required.add(name)
            self._failed_starts[name] = 0

    def unload(self, name: str) -> None:
        """Have a child not run any more, whatever its siblings do."""
        self._done.discard(name)
        self._required.discard(name)

    def was_started(self, name: str) -> bool:
        """Return whether a child was started before, with success or not."""
        return name in self._attempted

    def started(self, name: str) -> None:
        """Note that a child has become active."""
        self._failed_starts[name] = 0
        self._attempted.add(name)

    def ended(self, name: str, *, normal: bool, at_s: float, reason: str) -> RestartDecision:
        """Decide what follows when a child ended or failed to start (not normal), at `at_s` [s]."""
        if name not in self._required:
            return RestartDecision()
        child = self._children[name]
        if child.ends_supervisor and (normal or child.restart_type == "temporary"):
            if not normal:
                return self._give_up(f"{name} failed and is not restarted: {reason}")
            self._required.clear()
            return RestartDecision(finished=f"{name} has finished: {reason}")
        if child.restart_type == "temporary" or (child.restart_type == "transient" and normal):
            self._required.discard(name)
            if child.restart_type == "transient":
                self._done.add(name)
            return RestartDecision()
        return self._restart_after(name, at_s, reason)

    def start_failed(
        self, name: str, *, at_s: float, reason: str, refused: bool
    ) -> RestartDecision:
        """Decide what follows when a child did not become active.

        `refused`: the child reported that it cannot start, and a second attempt would not help;
        otherwise it was killed or did not answer.
        """
        first = name not in self._attempted
        self._attempted.add(name)
        self._failed_starts[name] += 1
        hopeless = first and refused and self._children[name].restart_type != "temporary"
        if hopeless and name in self._required:
            return self._give_up(f"{name}: {reason}")
        return self.ended(name, normal=False, at_s=at_s, reason=reason)

    def _give_up(self, reason: str) -> RestartDecision:
        self._required.clear()
        return RestartDecision(give_up=reason)

    def _restart_after(self, name: str, at_s: float, reason: str) -> RestartDecision:
        exceeded = self._exceeded_limit(name, at_s)
        if exceeded:
            return self._give_up(f"{exceeded}; last, {name}: {reason}")
        group = self._restart_group(name)
        stop = tuple(other for other in reversed(self.required) if other in group)
        for other in group - {name}:
            if self._children[other].restart_type == "temporary":
                self._required.discard(other)
            elif other in self._done:
                self._required.add(other)
        self._done -= group
        start = tuple(other for other in self.required if other in group)
        return RestartDecision(stop=tuple(other for other in stop if other != name), start=start)

    def _exceeded_limit(self, name: str, at_s: float) -> str:
        """Count a restart; return which limit it exceeds, "" if none."""
        allowed, within_s = self.supervision.max_restarts, self.supervision.within_s
        self._restart_times.append(at_s)
        while at_s - self._restart_times[0] > within_s:
            self._restart_times.popleft()
        if len(self._restart_times) > allowed:
            return f"given up after more than {allowed} restarts within {within_s:g} s"
        if self._failed_starts[name] > allowed:
            return f"given up after {self._failed_starts[name]} failed starts in a row"
        return ""

    def _restart_group(self, name: str) -> set[str]:
        """Return the children that are restarted together with this one, itself included."""
        match self.supervision.strategy:
            case "one_for_one":
                return {name}
            case "rest_for_one":
                return set(self._order[self._order.index(name) :])
            case "one_for_all":
                return set(self._order)
