"""What is sent to the base: the command while it is fresh, then rest, then nothing."""

from __future__ import annotations

Pair = tuple[float, float]
"""Forward [m/s] and turn [rad/s]."""

REST: Pair = (0.0, 0.0)


class Commanding:
    """Holds the newest command, and says what of it is to be sent on.

    Once a command is stale, rest is sent for `rest_s`, so often that no loss of a message matters;
    then nothing, so that another commander of the same base (a joystick) is not talked over. The
    base's own time limit is for the case that nothing arrives at all.

    A base that was started anew must not set off by itself with the command of the moment: its
    emergency stop may have been released. It rests until the command is rest, or ceases, once.
    """

    def __init__(self, speed: float, turn: float, timeout_s: float, rest_s: float) -> None:
        """Limits [m/s, rad/s]; `timeout_s`: the age at which a command is stale."""
        self._limits = (speed, turn)
        self._timeout_s = timeout_s
        self._rest_s = rest_s
        self._command = REST
        self._given_s: float | None = None
        self._rest_since: float | None = None
        self._awaits_rest = False

    @property
    def awaits_rest(self) -> bool:
        """Whether the command has to be rest, or to cease, before the base is driven again."""
        return self._awaits_rest

    def give(self, now: float, forward: float, turn: float) -> None:
        """Take a command at time `now` [s]."""
        self._command = _limited((forward, turn), self._limits)
        self._given_s = now

    def begin_anew(self, now: float) -> None:
        """Have the base rest, if it is commanded otherwise at time `now` [s]: it was started."""
        self._awaits_rest = self._fresh(now) and self._command != REST

    def due(self, now: float, *, usable: bool) -> Pair | None:
        """What is to be sent at time `now` [s]; None: nothing.

        `usable`: whether the base may be driven; if not, it is told to rest.
        """
        fresh = self._fresh(now)
        if not fresh or self._command == REST:
            self._awaits_rest = False
        if fresh and usable and not self._awaits_rest:
            self._rest_since = None
            return self._command
        if self._rest_since is None:
            self._rest_since = now
        return REST if fresh or now - self._rest_since <= self._rest_s else None

    def _fresh(self, now: float) -> bool:
        return self._given_s is not None and 0.0 <= now - self._given_s <= self._timeout_s


def _limited(command: Pair, limits: Pair) -> Pair:
    """The command on the same curve, no faster than the limits."""
    share = min(
        (limit / abs(value) for value, limit in zip(command, limits, strict=True) if value),
        default=1.0,
    )
    share = min(1.0, share)
    return share * command[0], share * command[1]
