"""A client of the velocity gate: the emergency stop, and driving as an operator."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cairn.bus import keys
from cairn.bus.codec import Codec
from cairn.bus.control import answering
from cairn.client.connection import resolve
from cairn.errors import CairnError
from cairn.schemas.builtin_interfaces import from_ns
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.cairn_nav_msgs import TeleoperationCommand, VelocityGateStatus
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.schemas.message import InvalidMessage
from cairn.schemas.std_msgs import Header
from cairn.system.closing import Closing

if TYPE_CHECKING:
    from cairn.client.robot import Robot

CONFIRM_S = 1.0
"""The gate must confirm an emergency stop within this time [s]."""
_ANSWER_S = 0.5  # of the gate, which has no handler that takes longer
_STATUS_PORT = "velocity_gate_status"
_LEASE_S = 10.0
_PERIOD_S = 0.05  # of commands that last
_REMEDY = (
    "press the robot's own emergency stop, or end the deployment: the base stops 0.3 s after the "
    "last command"
)


@dataclass(frozen=True)
class Gate:
    """A running velocity gate: its full name, and the topics of its ports by name."""

    name: str
    topics: Mapping[str, str]


def find_gate(robot: Robot, name: str) -> Gate:
    """Return the velocity gate of the robot of that name, "" if it is the only one.

    Raises `CairnError` if it runs no gate, or if the router is too busy to say.
    """
    try:
        gates = robot.connection.find(_gates)
    except CairnError as error:
        raise CairnError(f"{error}; {_REMEDY}") from error
    if not gates:
        raise CairnError(f"no velocity gate runs on the bus; {_REMEDY}")
    if len(gates) > 1:  # of several robots, or announced by tokens that are forged
        connection = robot.connection
        alive = set(answering(connection.session, connection.domain, name or "*", _ANSWER_S))
        gates = {full: gate for full, gate in gates.items() if full in alive} or gates
    return gates[resolve(gates, next(iter(gates)).rpartition("/")[2], name)]


def _gates(statuses: Mapping[str, ComponentStatus]) -> dict[str, Gate]:
    return {
        full: Gate(full, {port.port: port.topic for port in status.ports})
        for full, status in statuses.items()
        if any((port.port, port.direction) == (_STATUS_PORT, port.OUT) for port in status.ports)
    }


def set_emergency_stop(robot: Robot, name: str, reason: str | None) -> VelocityGateStatus:
    """Engage the emergency stop for a reason, or release it (None); return the confirming status.

    The request goes to the gate itself, not to its supervisor. Raises `CairnError` if the gate
    does not confirm it within `CONFIRM_S`.
    """
    gate = find_gate(robot, name)
    topic = gate.topics[_STATUS_PORT]
    engage = reason is not None
    verb, arguments = ("stop", {"reason": reason}) if engage else ("release_stop", {})
    deadline = time.monotonic() + CONFIRM_S
    connection, codec = robot.connection, Codec()
    key = keys.message_key(connection.domain, topic, VelocityGateStatus)
    with connection.listen(key, latched=True) as samples:
        try:
            connection.request(gate.name, verb, arguments, timeout_s=CONFIRM_S)
            while True:
                with suppress(InvalidMessage):
                    sample = samples.get(timeout=max(0.0, deadline - time.monotonic()))
                    status = codec.decode(VelocityGateStatus, sample.payload.to_bytes())
                    if status.emergency_stop == engage:
                        return status
        except (CairnError, queue.Empty) as error:
            cause = str(error) or f"no status on {topic}"
            if not engage:
                raise CairnError(f"{gate.name} has not confirmed the release: {cause}") from error
            raise CairnError(
                f"{gate.name} has not confirmed the emergency stop within {CONFIRM_S:g} s "
                f"({cause}); {_REMEDY}"
            ) from error


class Teleoperation(Closing):
    """The operator's lease of the velocity gate: call it to drive; a context manager.

    Each call sends a command, which the gate follows for 0.3 s. The lease is renewed by the calls,
    and ends 10 s after the last one.
    """

    def __init__(
        self,
        request: Callable[[str, dict[str, Any]], Any],
        publish: Callable[[TeleoperationCommand], object],
        operator: str,
        *,
        take_over: bool = False,
    ) -> None:
        """Acquire the lease, or take it over; `CairnError` if another operator has it."""
        self._request, self._publish = request, publish
        verb = "take_over_lease" if take_over else "acquire_lease"
        sent = time.time_ns()
        granted = request(verb, {"operator": operator, "seconds": _LEASE_S})
        self._lease = int(granted["lease"])
        # Stamps are in the robot's time, also if this computer's clock differs from it.
        self._ahead_ns = int(granted["now_ns"]) - (sent + time.time_ns()) // 2
        self._renewed = time.monotonic()

    def __call__(self, speed: float, turn: float = 0.0, *, seconds: float = 0.0) -> None:
        """Drive at a speed [m/s] and turn rate [rad/s], for 0.3 s or for `seconds`.

        Raises `CairnError` if the lease is over.
        """
        twist = Twist(linear=Vector3(x=float(speed)), angular=Vector3(z=float(turn)))
        ends = time.monotonic() + seconds
        while True:
            now = time.monotonic()
            if now - self._renewed > _LEASE_S / 3.0:
                self._request("renew_lease", {"lease": self._lease, "seconds": _LEASE_S})
                self._renewed = now
            stamp = from_ns(time.time_ns() + self._ahead_ns)
            self._publish(
                TeleoperationCommand(header=Header(stamp=stamp), lease=self._lease, twist=twist)
            )
            if now + _PERIOD_S >= ends:
                return
            time.sleep(_PERIOD_S)

    def close(self) -> None:
        """Release the lease; the robot stops, and the navigator may drive again."""
        with suppress(CairnError):
            self._request("release_lease", {"lease": self._lease})
