"""Making a RoboClaw ready to drive: what is set, read back and refused."""

from __future__ import annotations

from dataclasses import dataclass

from cairn import CairnError
from cairn.components.roboclaw import commands
from cairn.components.roboclaw.commands import (
    MAIN_VOLTAGES,
    NEW_MAIN_VOLTAGES,
    SPEED_LOOPS,
    TIMEOUT,
    TIMEOUT_STEP_S,
)
from cairn.components.roboclaw.dialogue import Dialogue
from cairn.components.roboclaw.kinematics import Geometry, Limits

_FULL_SPEED_SHARE = 0.95  # the speed loop needs something in hand


class NotUsable(CairnError):  # noqa: N818 - it tells what is
    """The RoboClaw works, but must not drive this base as things are set."""


@dataclass(frozen=True)
class Ready:
    """What was found of a RoboClaw that is ready to drive."""

    version: str
    fastest_wheel: float
    """The speed that both wheels can be held to [m/s]."""
    kept_power: bool
    """Whether it still had the driver's serial timeout: its counters go on then."""


def set_up(
    dialogue: Dialogue,
    geometry: Geometry,
    limits: Limits,
    timeout_s: float,
    main_voltages: tuple[float, float] | None,
) -> Ready:
    """Set the serial timeout and the battery's limits, and check that speed loops are tuned.

    `timeout_s`: after which the RoboClaw stops the motors by itself [s]; `main_voltages`: lowest
    and highest of the main battery [V], None to leave them as they are. Raises `DeviceError` if it
    does not answer, `NotUsable` if it cannot be used so.
    """
    version = dialogue.version()
    kept = _set_timeout(dialogue, version, timeout_s)
    if main_voltages is not None:
        _set_main_voltages(dialogue, version, main_voltages)
    return Ready(version, _fastest(dialogue, version, geometry, limits), kept)


def check_timeout(dialogue: Dialogue, timeout_s: float) -> bool:
    """Whether the serial timeout [s] is the one that was set."""
    return dialogue.ask(TIMEOUT) == (commands.timeout_steps(timeout_s),)


def _set_timeout(dialogue: Dialogue, version: str, timeout_s: float) -> bool:
    kept = check_timeout(dialogue, timeout_s)
    dialogue.order(commands.set_timeout(timeout_s))
    if not check_timeout(dialogue, timeout_s):
        (found,) = dialogue.ask(TIMEOUT)
        raise NotUsable(
            f"{version}: its serial timeout is {found * TIMEOUT_STEP_S:g} s after {timeout_s:g} s "
            "were set; without it nothing would stop the wheels if this process hung, so it is not "
            "used: update its firmware"
        )
    return kept


def _set_main_voltages(dialogue: Dialogue, version: str, limits: tuple[float, float]) -> None:
    _, _, *rest = dialogue.ask_either(NEW_MAIN_VOLTAGES, MAIN_VOLTAGES)
    dialogue.order(commands.set_main_voltages(*limits, *rest))
    low, high, *_ = dialogue.ask_either(NEW_MAIN_VOLTAGES, MAIN_VOLTAGES)
    if (low, high) != tuple(round(10 * one) for one in limits):
        raise NotUsable(
            f"{version}: the main battery's limits are {low / 10:g} to {high / 10:g} V after "
            f"{limits[0]:g} to {limits[1]:g} V were set; this model may not take them: change "
            "battery_min_v and battery_max_v"
        )


def _fastest(dialogue: Dialogue, version: str, geometry: Geometry, limits: Limits) -> float:
    loops = [dialogue.ask(loop) for loop in SPEED_LOOPS]
    for number, (p, i, d, full_speed) in enumerate(loops, start=1):
        if not full_speed or not (p or i or d):
            raise NotUsable(
                f"{version}: the speed loop of M{number} is not tuned (P {p}, I {i}, D {d}, QPPS "
                f"{full_speed}); tune it in Motion Studio and save it, see docs/drivers/base.md"
            )
    fastest = _FULL_SPEED_SHARE * geometry.fastest_wheels(loops[0][3], loops[1][3])
    if limits.speed > fastest:
        raise NotUsable(
            f"{version}: the wheels reach {fastest:.2f} m/s by the QPPS of its speed loops, less "
            f"than speed = {limits.speed:g} m/s; lower speed, or correct wheel_radius, "
            "counts_per_turn or QPPS"
        )
    return fastest
