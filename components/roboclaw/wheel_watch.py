"""Whether wheels do what they are asked: stalled ones, false signs, wheels that run away."""

from __future__ import annotations

from dataclasses import dataclass

from cairn.components.roboclaw.kinematics import Pair

_STANDS, _BACKWARDS, _RUNS_AWAY = "stands", "backwards", "runs_away"


@dataclass(frozen=True)
class WatchLimits:
    """From which speed on a wheel is judged [m/s], and how long it may be wrong [s]."""

    speed: float
    stands_s: float
    runs_s: float


class WheelWatch:
    """Compares wheel speeds asked for with those that the encoders show.

    A wheel whose encoder counts against its motor is driven ever faster by its speed loop, and one
    whose encoder is silent as well. So both have to be switched off, not asked to stand still.
    """

    def __init__(self, limits: WatchLimits) -> None:
        self._limits = limits
        self._since: dict[tuple[str, str], float] = {}

    def forget(self) -> None:
        """Begin anew: what was asked for was not carried out, for a reason that is known."""
        self._since.clear()

    def judge(self, now: float, asked: Pair, seen: Pair) -> str | None:
        """What is wrong with a wheel at time `now` [s], as a sentence; None if nothing is.

        `asked` and `seen`: speeds [m/s] of the left and the right wheel.
        """
        for wheel, want, have in zip(("left", "right"), asked, seen, strict=True):
            for fault, (wrong, limit_s) in self._signs(want, have).items():
                key = (wheel, fault)
                if not wrong:
                    self._since.pop(key, None)
                elif now - self._since.setdefault(key, now) >= limit_s:
                    return _sentence(wheel, fault, want, have)
        return None

    def _signs(self, want: float, have: float) -> dict[str, tuple[bool, float]]:
        limits = self._limits
        asked = abs(want) >= limits.speed
        along = have if want > 0 else -have
        return {
            _STANDS: (asked and abs(have) < 0.1 * limits.speed, limits.stands_s),
            _BACKWARDS: (asked and along < -0.5 * limits.speed, limits.runs_s),
            _RUNS_AWAY: (abs(have) > 2.0 * abs(want) + 2.0 * limits.speed, limits.runs_s),
        }


def _sentence(wheel: str, fault: str, want: float, have: float) -> str:
    asked = f"the {wheel} wheel was asked for {want:.2f} m/s"
    match fault:
        case "stands":
            return (
                f"{asked}, and its encoder stands still: the wheel is blocked, its motor is off, or"
                " the encoder's cable is"
            )
        case "backwards":
            return (
                f"{asked}, and its encoder shows {have:.2f} m/s: it counts against its motor, or "
                "the channels are exchanged; `cairn driver probe base` with --turn-wheels tells"
            )
        case _:
            return f"{asked}, and its encoder shows {have:.2f} m/s: it runs away"
