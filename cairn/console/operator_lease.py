"""The console's operator's lease: which browser steers a robot; the others watch, and may ask."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final

from cairn.errors import CairnError

ANSWER_S: Final = 30.0
"""An operator who does not answer for so long [s] who asks loses the lease, as to a closed tab."""


@dataclass(frozen=True)
class Operator:
    """A browser that steers, or wants to: the number of its connection, and a name for people."""

    id: int
    name: str


@dataclass
class _Lease:
    holder: Operator
    asked_by: Operator | None = None
    asked_at: float = 0.0


class OperatorLeases:
    """One lease per robot. `now` returns the time [s] on a clock that is never set."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._leases: dict[str, _Lease] = {}

    def acquire(self, robot: str, operator: Operator) -> None:
        """Give the lease to an operator; `CairnError` if another one has it."""
        lease = self._leases.get(robot)
        if lease is not None and lease.holder.id != operator.id:
            raise CairnError(
                f"{robot}: {lease.holder.name} steers; ask for the lease (ask_lease), or watch"
            )
        if lease is None:
            self._leases[robot] = _Lease(operator)

    def release(self, robot: str, operator_id: int) -> None:
        """End the lease of an operator, for the one who has asked for it; nothing if it is not his.

        It is free otherwise.
        """
        lease = self._leases.get(robot)
        if lease is None or lease.holder.id != operator_id:
            return
        if lease.asked_by is not None:
            self._leases[robot] = _Lease(lease.asked_by)
        else:
            del self._leases[robot]

    def ask(self, robot: str, operator: Operator) -> bool:
        """Ask the holder for the lease; return True if it was free and is the operator's now."""
        lease = self._leases.get(robot)
        if lease is None or lease.holder.id == operator.id:
            self.acquire(robot, operator)
            return True
        if lease.asked_by is None:
            lease.asked_by, lease.asked_at = operator, self._now()
        elif lease.asked_by.id != operator.id:
            raise CairnError(
                f"{robot}: {lease.asked_by.name} has asked {lease.holder.name} for the lease "
                "already; ask again later"
            )
        return False

    def answer(self, robot: str, operator_id: int, *, grant: bool) -> None:
        """Answer the one who asks, as the holder: grant the lease, or refuse."""
        lease = self._leases.get(robot)
        if lease is None or lease.holder.id != operator_id:
            raise CairnError(f"{robot}: only the operator who holds the lease can give it away")
        if lease.asked_by is None:
            raise CairnError(f"{robot}: no operator asks for the lease now")
        if grant:
            self._leases[robot] = _Lease(lease.asked_by)
        else:
            lease.asked_by = None

    def leave(self, operator_id: int) -> list[str]:
        """End all leases and requests of a browser that is gone; return the robots concerned."""
        concerned = []
        for robot, lease in list(self._leases.items()):
            if lease.asked_by is not None and lease.asked_by.id == operator_id:
                lease.asked_by = None
                concerned.append(robot)
            if lease.holder.id == operator_id:
                self.release(robot, operator_id)
                concerned.append(robot)
        return list(dict.fromkeys(concerned))

    def expire(self) -> list[str]:
        """Pass on the leases whose holders have not answered in time; return these robots."""
        late = [
            (robot, lease.holder.id)
            for robot, lease in self._leases.items()
            if lease.asked_by is not None and self._now() - lease.asked_at >= ANSWER_S
        ]
        for robot, holder in late:
            self.release(robot, holder)
        return [robot for robot, _ in late]

    def holds(self, robot: str, operator_id: int) -> bool:
        """Return whether a browser has the lease of a robot."""
        lease = self._leases.get(robot)
        return lease is not None and lease.holder.id == operator_id

    def require(self, robot: str, operator_id: int) -> None:
        """Raise `CairnError` unless a browser has the lease of a robot."""
        if self.holds(robot, operator_id):
            return
        lease = self._leases.get(robot)
        if lease is None:
            raise CairnError(f"{robot}: take the lease first, to steer it (acquire_lease)")
        raise CairnError(
            f"{robot}: {lease.holder.name} steers; ask for the lease first (ask_lease)"
        )

    def held(self) -> Iterable[tuple[str, int]]:
        """Return the robots that are steered, each with the number of the browser."""
        return [(robot, lease.holder.id) for robot, lease in self._leases.items()]

    def state(self, robot: str, operator_id: int) -> dict[str, Any]:
        """Return the lease of a robot as a browser sees it: `holder` and `asked_by` may be ""."""
        lease = self._leases.get(robot)
        asked_by = lease.asked_by if lease is not None else None
        return {
            "robot": robot,
            "holder": lease.holder.name if lease is not None else "",
            "mine": self.holds(robot, operator_id),
            "asked_by": asked_by.name if asked_by is not None else "",
            "asked_by_me": asked_by is not None and asked_by.id == operator_id,
        }
