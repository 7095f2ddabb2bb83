"""Keeps a component's children running: brings what runs to what the policy wants, in order."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NoReturn

from cairn.errors import CairnError
from cairn.supervision.child import ChildEnd, ChildRules, Launcher
from cairn.supervision.events import ChildStatus, SupervisionEvent, What
from cairn.supervision.policy import (
    ChildPolicy,
    Decision,
    Intensity,
    Policy,
    Strategy,
    UnknownChild,
)
from cairn.supervision.slot import Slot, StartFailure, StopRequested


class Escalate(CairnError):  # noqa: N818 - what the owner is to do
    """A supervisor has given up and stopped all children: its owner is to end abnormally."""


class StartFailed(CairnError):  # noqa: N818 - reads as what happened
    """A child loaded by order did not become active and is unloaded again."""


@dataclass(frozen=True)
class _Hung:
    name: str
    incarnation: int
    reason: str


class Supervisor:
    """Starts, restarts and stops children in one thread, the owner's.

    `child_hung` and `request_stop` may be called from any thread and from signal handlers: they
    only take note. The owner then calls `reconcile`, as whenever a child may have ended.

    `observe` is told all that happens. `progress` is called before each step with what is about to
    be done and how long it may take at most [s], so that the owner can say that it is not hung.
    """

    def __init__(
        self,
        name: str,
        children: Sequence[ChildRules],
        launcher: Launcher,
        *,
        observe: Callable[[SupervisionEvent], None],
        progress: Callable[[str, float], None],
        strategy: Strategy = "one_for_one",
        intensity: Intensity | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """`name` is the owner's, `children` are in start order. Raises `ValueError` for twins."""
        self.name = name
        self._slots = {spec.name: Slot(spec, launcher, observe, progress, now) for spec in children}
        policies = [ChildPolicy(spec.name, spec.restart, spec.significant) for spec in children]
        self._policy = Policy(policies, strategy, intensity)
        self._observe = observe
        self._now = now
        self._inbox: deque[_Hung] = deque()
        self._stop_requested = False
        self._finished: ChildEnd | None = None

    @property
    def finished(self) -> ChildEnd | None:
        """Why all is done, None if it is not: a significant child ended normally; all stopped."""
        return self._finished

    @property
    def stop_requested(self) -> bool:
        """Whether `request_stop` was called: launchers and children may cut their waits short."""
        return self._stop_requested

    def status(self) -> list[ChildStatus]:
        """All children in start order."""
        return [slot.status() for slot in self._slots.values()]

    def child_hung(self, name: str, incarnation: int, handler: str, seconds: float) -> None:
        """Note that a child has been in a handler for too long: it will be killed.

        A former incarnation's changes nothing.
        """
        self._slot(name)
        reason = f"hung in {handler} for {seconds:.1f} s and was killed"
        self._inbox.append(_Hung(name, incarnation, reason))

    def request_stop(self) -> None:
        """Have nothing started any more, from the next step on; `stop_all` is then to be called."""
        self._stop_requested = True

    def start_all(self) -> None:
        """Start the children that load at start, each when the former is active.

        One that dies meanwhile is restarted as at any time; one that says it cannot start has all
        fail, as `Policy` tells. Returns when all are active, or a stop was requested, or all is
        `finished`. Raises as `reconcile`.
        """
        self._finished = None
        for name, slot in self._slots.items():
            if slot.spec.load == "at_start":
                self._policy.load(name)
        self.reconcile()

    def reconcile(self) -> None:
        """Take note of what has happened, and stop and start children accordingly.

        Call it whenever something was noted, and now and then. Raises `Escalate` when the policy
        says so, or a child is to be restarted that does not end even when killed: two of it must
        never run. All children are stopped then. Raises `LauncherLost` with what it says; the owner
        then calls `stop_all`.
        """
        try:
            while not self._stop_requested:
                self._notice()
                slot = self._next_to_start()
                if slot is None:
                    return
                if slot.stuck:
                    self._give_up(f"given up: {slot.spec.name} does not end even when killed")
                self._start(slot)
        except StopRequested:
            return

    def load(self, name: str) -> None:
        """Start a child that is not loaded, nothing if it is.

        One that dies on the way is tried again, as often as restarts are allowed. Raises
        `UnknownChild`; `StartFailed` with the cause if it does not become active, which then counts
        for nothing: it is for whoever gave the order to decide.
        """
        slot = self._slot(name)
        if not self._policy.load(name).start:
            return
        failure = self._load(slot)
        if failure:
            self._policy.unload(name)
            raise StartFailed(f"{name}: {failure}")

    def unload(self, name: str) -> None:
        """Stop a child and leave it stopped, nothing if it is not loaded. Raises `UnknownChild`."""
        slot = self._slot(name)
        self._policy.unload(name)
        slot.stop()
        slot.state = "unloaded"

    def restart(self, name: str) -> None:
        """Stop a child and start it anew, or load it. Raises `UnknownChild` and as `reconcile`."""
        slot = self._slot(name)
        if name not in self._policy.wanted:
            self.load(name)
            return
        self._policy.restart(name)
        slot.stop()
        self.reconcile()

    def stop_all(self) -> None:
        """Stop all children in reverse order, whatever any of them does, and leave them stopped."""
        for name in self._slots:
            self._policy.unload(name)
        for slot in reversed(self._slots.values()):
            slot.stop()
            slot.state = "unloaded"
        self._inbox.clear()

    def _notice(self) -> None:
        while self._inbox:
            note = self._inbox.popleft()
            slot = self._slots[note.name]
            if slot.child is None or note.incarnation != slot.incarnation:
                continue  # about a former incarnation
            slot.kill()
            self._ended(slot, "hung", ChildEnd(False, note.reason))
        for slot in self._slots.values():
            found = slot.look()
            if found is not None:
                self._ended(slot, "ended", found)

    def _ended(self, slot: Slot, what: What, end: ChildEnd) -> None:
        slot.ended(what, end)
        name, at_s = slot.spec.name, self._now()
        decision = self._policy.ended(name, normal=end.normal, at_s=at_s, reason=end.reason)
        if decision.finished:
            self._finished = ChildEnd(True, decision.finished, end.success)
        self._apply(decision)

    def _apply(self, decision: Decision) -> None:
        for name in decision.stop:
            self._slots[name].stop()
        for name in decision.start:
            self._slots[name].restarts += self._slots[name].incarnation > 0
        if decision.give_up:
            self._give_up(decision.give_up)

    def _give_up(self, why: str) -> NoReturn:
        self.stop_all()
        self._observe(SupervisionEvent(self._now(), self.name, 0, "given_up", why))
        raise Escalate(why)

    def _next_to_start(self) -> Slot | None:
        slots = (self._slots[name] for name in self._policy.wanted)
        return next((slot for slot in slots if slot.child is None), None)

    def _start(self, slot: Slot) -> None:
        failure = self._started(slot)
        if failure is None:
            return
        decision = self._policy.start_failed(
            slot.spec.name, at_s=self._now(), reason=failure.reason, accident=failure.accident
        )
        self._apply(decision)

    def _load(self, slot: Slot) -> str:
        """Lead a child to active; gives why that failed, "" if it did not."""
        tries = 1 + self._policy.intensity.max_restarts
        try:
            while not self._stop_requested:
                if slot.stuck:
                    return "it still runs, and does not end even when killed"
                failure = self._started(slot)
                if failure is None:
                    return ""
                tries -= 1
                if tries == 0 or not failure.accident:
                    return failure.reason
        except StopRequested:
            slot.stop()
        return "a stop was requested"

    def _started(self, slot: Slot) -> StartFailure | None:
        failure = slot.start(lambda: self._stop_requested)
        if failure is None:
            self._policy.started(slot.spec.name)
        return failure

    def _slot(self, name: str) -> Slot:
        if name not in self._slots:
            raise UnknownChild(
                f"{self.name} has no child {name}, but: {', '.join(self._slots) or 'none'}"
            )
        return self._slots[name]
