"""Sources of velocity commands: what they may command, which one drives, the operator's lease.

Times are in nanoseconds of the component's clock.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from cairn import SECOND, CairnError
from cairn.components.velocity_gate.limiter import Velocity
from cairn.schemas.geometry_msgs import Twist

NAVIGATOR, TELEOPERATION, EXTERNAL = "navigator", "teleoperation", "external"

MOST_LEASE_S = 60.0
"""Longest time [s] for which a lease is granted or renewed."""
_MOST_NAME = 64  # characters of an operator's name


@dataclass(frozen=True)
class SourceSettings:
    """A source's name, its priority [1], and the age [s] at which its commands are stale."""

    name: str
    priority: int
    timeout_s: float


@dataclass(frozen=True)
class Selection:
    """The source that drives, and its command."""

    source: str
    command: Velocity


def velocity_of(command: Twist) -> Velocity | None:
    """Return a command's speed and turn rate; None if it moves sideways, up, or tilts."""
    linear, angular = command.linear, command.angular
    if any((linear.y, linear.z, angular.x, angular.y)):
        return None
    return linear.x, angular.z


class SourceSelector:
    """Holds the newest command of each source, and selects the one that drives."""

    def __init__(self, sources: Iterable[SourceSettings]) -> None:
        self._sources = sorted(sources, key=lambda one: -one.priority)
        self._commands: dict[str, tuple[int, Velocity]] = {}
        self._ignored_until = 0

    def set(self, source: str, now: int, command: Velocity) -> bool:
        """Set the newest command of a source; return False if it is ignored as late."""
        if now < self._ignored_until:
            return False
        self._commands[source] = now, command
        return True

    def drop(self, source: str) -> None:
        """Drop the command of a source."""
        self._commands.pop(source, None)

    def drop_all(self, ignored_until: int = 0) -> None:
        """Drop all commands, and ignore those that arrive before that time.

        After this process was held up, what was queued meanwhile arrives at once. Commands without
        a stamp do not show their age.
        """
        self._commands.clear()
        self._ignored_until = ignored_until

    def select(self, now: int, *, reserved: str = "") -> Selection | None:
        """Return the source with the highest priority among those with a fresh command.

        While the robot is `reserved` for a source, those with a lower priority do not drive, also
        while it is silent.
        """
        for source in self._sources:
            at, command = self._commands.get(source.name, (None, (0.0, 0.0)))
            # A command from the future: time was set back, so its age is not known.
            if at is not None and 0 <= now - at <= source.timeout_s * SECOND:
                return Selection(source.name, command)
            if source.name == reserved:
                return None
        return None


class OperatorLease:
    """The right to drive by teleoperation: one operator has it, for a limited time.

    `new_id` returns a random number from 1 to 2^63 that cannot be guessed.
    """

    def __init__(self, new_id: Callable[[], int]) -> None:
        self._new_id = new_id
        self._id = 0
        self._operator = ""
        self._granted = self._ends = 0

    def operator(self, now: int) -> str:
        """Return the name of the operator who has the lease; "" if it is free."""
        # If time was set back, the lease is over: how long it was held is not known.
        if self._id and not self._granted <= now < self._ends:
            self._id, self._operator = 0, ""
        return self._operator

    def is_valid(self, lease: int, now: int) -> bool:
        """Return whether this is the id of the current lease."""
        return bool(self.operator(now)) and lease == self._id

    def acquire(self, operator: str, seconds: float, now: int) -> int:
        """Grant the lease and return its id; `CairnError` if another operator has it."""
        _check(operator, seconds)
        holder = self.operator(now)
        if holder:
            raise CairnError(
                f"the operator's lease is held by {holder} for another "
                f"{(self._ends - now) / SECOND:.1f} s; wait, or take it over"
            )
        return self._grant(operator, seconds, now)

    def take_over(self, operator: str, seconds: float, now: int) -> tuple[int, str]:
        """Grant the lease, also if it is held; return its id and the previous holder."""
        _check(operator, seconds)
        before = self.operator(now)
        return self._grant(operator, seconds, now), before

    def renew(self, lease: int, seconds: float, now: int) -> None:
        """Let the lease end `seconds` from now; `CairnError` if it is not the current one."""
        self._require(lease, now)
        _check(self._operator, seconds)
        self._granted, self._ends = now, now + round(seconds * SECOND)

    def release(self, lease: int, now: int) -> None:
        """End the lease; `CairnError` if it is not the current one."""
        self._require(lease, now)
        self._id, self._operator = 0, ""

    def _require(self, lease: int, now: int) -> None:
        if not self.is_valid(lease, now):
            holder = self.operator(now)
            state = f"{holder} has the lease now" if holder else "it is free"
            raise CairnError(f"this operator's lease is not valid ({state}); acquire it again")

    def _grant(self, operator: str, seconds: float, now: int) -> int:
        self._id, self._operator = self._new_id(), operator
        self._granted, self._ends = now, now + round(seconds * SECOND)
        return self._id


def _check(operator: str, seconds: float) -> None:
    if not (operator.isprintable() and 0 < len(operator.strip()) <= len(operator) <= _MOST_NAME):
        raise CairnError(
            f"operator's lease: {operator[:_MOST_NAME]!r} is not a name; give 1 to {_MOST_NAME} "
            "printable characters"
        )
    if not 0.0 < seconds <= MOST_LEASE_S:  # also NaN
        raise CairnError(
            f"operator's lease: {seconds:g} s is not a duration of more than 0 and at most "
            f"{MOST_LEASE_S:g} s"
        )
