"""Detection of wheel faults: blocked wheels, reversed encoders, wheels that run away."""

from __future__ import annotations

from dataclasses import dataclass

from cairn.components.roboclaw_base.kinematics import Pair

_BLOCKED, _REVERSED, _RUNAWAY = "blocked", "reversed", "runaway"
_BLOCKED_SHARE = 0.1  # of `speed`: an encoder that shows less stands
_REVERSED_SHARE = 0.5  # of `speed`: an encoder that shows more, backwards, is reversed
_RUNAWAY_FACTOR = 2.0  # times commanded speed and `speed`


@dataclass(frozen=True)
class WheelFaultLimits:
    """From which commanded speed a wheel is judged [m/s], and how long it may be wrong [s]."""

    speed: float
    blocked_s: float
    runaway_s: float


class WheelFaultDetector:
    """Compares commanded wheel speeds with those that the encoders show.

    The speed loop drives a wheel ever faster if its encoder counts against its motor, or does not
    count at all. So both motors must be switched off then, not commanded to speed 0.
    """

    def __init__(self, limits: WheelFaultLimits) -> None:
        self._limits = limits
        self._since: dict[tuple[str, str], float] = {}

    def reset(self) -> None:
        """Start again: the commands were not executed, for a known reason."""
        self._since.clear()

    def check(self, now: float, commanded: Pair, measured: Pair) -> str | None:
        """Return the fault of a wheel at time `now` [s] as a sentence; None if there is none.

        `commanded` and `measured`: speeds [m/s] of the left and the right wheel.
        """
        wheels = zip(("left", "right"), commanded, measured, strict=True)
        for wheel, target, speed in wheels:
            for fault, (wrong, limit_s) in self._symptoms(target, speed).items():
                key = (wheel, fault)
                if not wrong:
                    self._since.pop(key, None)
                elif now - self._since.setdefault(key, now) >= limit_s:
                    return _sentence(wheel, fault, target, speed)
        return None

    def _symptoms(self, target: float, speed: float) -> dict[str, tuple[bool, float]]:
        limits = self._limits
        moving = abs(target) >= limits.speed
        along = speed if target > 0 else -speed
        runaway = _RUNAWAY_FACTOR * (abs(target) + limits.speed)
        return {
            _BLOCKED: (moving and abs(speed) < _BLOCKED_SHARE * limits.speed, limits.blocked_s),
            _REVERSED: (moving and along < -_REVERSED_SHARE * limits.speed, limits.runaway_s),
            _RUNAWAY: (abs(speed) > runaway, limits.runaway_s),
        }


def _sentence(wheel: str, fault: str, target: float, speed: float) -> str:
    commanded = f"the {wheel} wheel was commanded to {target:.2f} m/s"
    if fault == _BLOCKED:
        return (
            f"{commanded}, but its encoder stands still: the wheel is blocked, or its motor or the "
            "encoder's cable is disconnected; check them"
        )
    if fault == _REVERSED:
        return (
            f"{commanded}, but its encoder shows {speed:.2f} m/s: it counts against its motor, or "
            "the channels are exchanged; run `cairn driver probe base` with --turn-wheels"
        )
    return (
        f"{commanded}, but its encoder shows {speed:.2f} m/s: it runs away; check its wiring and "
        "speed loop"
    )
