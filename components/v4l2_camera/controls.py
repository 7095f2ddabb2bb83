"""A camera's controls: exposure, gain and the like, with the bounds that the camera gives them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from cairn.components.v4l2_camera import videodev

# Numbers of the usual controls (linux/v4l2-controls.h). Kernels changed their names (until 5.15
# `exposure_auto` was what is `auto_exposure` now), never their numbers. Those that switch something
# to automatic come before what they take over: a camera refuses an exposure while it exposes
# automatically.
STANDARD: Final = {
    "auto_exposure": 0x009A0901,
    "exposure_time_absolute": 0x009A0902,
    "exposure_dynamic_framerate": 0x009A0903,
    "gain_automatic": 0x00980912,
    "gain": 0x00980913,
    "brightness": 0x00980900,
    "contrast": 0x00980901,
    "saturation": 0x00980902,
    "gamma": 0x00980910,
    "sharpness": 0x0098091B,
    "backlight_compensation": 0x0098091C,
    "power_line_frequency": 0x00980918,
    "white_balance_automatic": 0x0098090C,
    "white_balance_temperature": 0x0098091A,
    "focus_automatic_continuous": 0x009A090C,
    "focus_absolute": 0x009A090A,
}

SETTABLE: Final = (
    videodev.CTRL_TYPE_INTEGER,
    videodev.CTRL_TYPE_BOOLEAN,
    videodev.CTRL_TYPE_MENU,
    videodev.CTRL_TYPE_BITMASK,
    videodev.CTRL_TYPE_INTEGER_MENU,
)
"""Types of controls that have a number as their value; buttons, strings and arrays have none."""


class ControlRefused(Exception):  # noqa: N818 - reads as what the camera says
    """A camera does not take a value of a control; the text has its bounds."""


@dataclass(frozen=True)
class Control:
    """One control of a camera; `items` are those of a menu, by value."""

    id: int
    name: str
    type: int
    minimum: int
    maximum: int
    step: int
    default: int
    flags: int
    items: Mapping[int, str] = field(default_factory=dict)

    @property
    def read_only(self) -> bool:
        """Whether nobody can set it."""
        return bool(self.flags & videodev.CTRL_FLAG_READ_ONLY)

    @property
    def inactive(self) -> bool:
        """Whether it has no effect now, as something automatic has taken it over."""
        return bool(self.flags & videodev.CTRL_FLAG_INACTIVE)

    @property
    def bounds(self) -> str:
        """What values it takes, in words."""
        if self.items:
            return ", ".join(f"{value} ({text})" for value, text in sorted(self.items.items()))
        if self.type == videodev.CTRL_TYPE_BITMASK:
            return f"bits of {self.maximum & 0xFFFFFFFF:#x}"
        steps = f" in steps of {self.step}" if self.step > 1 else ""
        return f"{self.minimum} to {self.maximum}{steps}"

    def judge(self, value: int) -> None:
        """Raise `ControlRefused` if the control does not take the value."""
        if self.read_only:
            raise ControlRefused(f"{self.name} can only be read")
        if not self._takes(value):
            raise ControlRefused(f"{self.name} = {value}: the camera takes {self.bounds}")

    def _takes(self, value: int) -> bool:
        if self.items:
            return value in self.items
        if self.type == videodev.CTRL_TYPE_BITMASK:
            return not value & ~(self.maximum & 0xFFFFFFFF)
        step = max(self.step, 1)
        return self.minimum <= value <= self.maximum and (value - self.minimum) % step == 0


def plain_name(told: str) -> str:
    """A control's name as v4l2-ctl writes it: `Exposure Time, Absolute` is
    `exposure_time_absolute`.
    """
    return re.sub(r"[^a-z0-9]+", "_", told.lower()).strip("_")


def assigned(
    controls: Mapping[str, Control], wanted: Mapping[str, int]
) -> list[tuple[Control, int]]:
    """Which control gets which value, in the order in which they are to be set.

    `controls` are a camera's, by plain name. Raises `ControlRefused` for one that it does not have
    or a value that it does not take.
    """
    by_id = {control.id: control for control in controls.values()}
    found = []
    for name in sorted(wanted, key=_turn):
        control = by_id.get(STANDARD.get(name, -1)) or controls.get(name)
        if control is None:
            raise ControlRefused(
                f"the camera has no control {name}; it has {', '.join(sorted(controls)) or 'none'}"
            )
        control.judge(wanted[name])
        found.append((control, wanted[name]))
    return found


def _turn(name: str) -> int:
    order = list(STANDARD)
    return order.index(name) if name in STANDARD else len(order)
