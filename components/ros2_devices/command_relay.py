"""What is sent to the base: fresh velocity commands; rest once they are stale, then nothing."""

from __future__ import annotations

from cairn import from_ns
from cairn.driver.command_timeout import REST, LatestCommand, Velocity
from cairn.planar.messages import twist_message
from cairn.schemas.geometry_msgs import TwistStamped
from cairn.schemas.std_msgs import Header


class CommandRelay:
    """Holds the newest velocity command, and decides what to send to the base.

    Once a command is stale, rest is sent for `rest_s`, often enough that a lost message does not
    matter; then nothing, so that another commander of the same base (a joystick) is not overridden.
    The base's own timeout is for the case that nothing arrives at all.

    A base that was restarted must not start moving by itself with the present command, as its
    emergency stop may have been released. It rests until the command is rest, or ceases, once.
    """

    def __init__(self, speed: float, turn: float, timeout_s: float, rest_s: float) -> None:
        """Set limits [m/s, rad/s]; `timeout_s`: the age at which a command is stale."""
        self._limits = (speed, turn)
        self._rest_s = rest_s
        self._command = LatestCommand(timeout_s)
        self._rest_since: float | None = None
        self.awaits_rest = False
        """Whether the command must be rest, or cease, before the base is driven again."""

    def set(self, now: float, forward: float, turn: float) -> None:
        """Set the command, received at time `now` [s]."""
        self._command.set(now, *_limit((forward, turn), self._limits))

    def base_restarted(self, now: float) -> None:
        """Let the base rest if it is commanded to move at time `now` [s]."""
        self.awaits_rest = (self._command.fresh(now) or REST) != REST

    def due(self, now: float, *, usable: bool) -> Velocity | None:
        """Return what to send at time `now` [s]; None: nothing.

        `usable`: whether the base may be driven; if not, it is commanded to rest.
        """
        command = self._command.fresh(now)
        if command is None or command == REST:
            self.awaits_rest = False
        if command is not None and usable and not self.awaits_rest:
            self._rest_since = None
            return command
        if self._rest_since is None:
            self._rest_since = now
        is_due = command is not None or 0 <= now - self._rest_since <= self._rest_s
        return REST if is_due else None


def stamped_twist(stamp: int, frame: str, forward: float, turn: float) -> TwistStamped:
    """Return a stamped command [ns] in the base's own frame; 0 means the base's present time."""
    return TwistStamped(
        header=Header(stamp=from_ns(stamp), frame_id=frame), twist=twist_message(forward, turn)
    )


def _limit(command: Velocity, limits: Velocity) -> Velocity:
    """Scale a command into the limits by one factor, so the curve is kept."""
    share = min(
        (limit / abs(value) for value, limit in zip(command, limits, strict=True) if value),
        default=1.0,
    )
    share = min(1.0, share)
    return share * command[0], share * command[1]
