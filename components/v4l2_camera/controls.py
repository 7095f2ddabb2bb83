"""Controls of a camera: exposure, gain and others, with the bounds that the camera reports."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from cairn.components.v4l2_camera import videodev

# Ids of the usual controls (linux/v4l2-controls.h). Kernels changed their names (until 5.15
# `auto_exposure` was `exposure_auto`), never their ids. Controls that switch something to automatic
# come before what they control: a camera refuses an exposure time while it exposes automatically.
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


class ControlRejected(Exception):
    """A camera does not accept a value of a control; the text has its bounds."""


@dataclass(frozen=True)
class CameraControl:
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
        """Whether it cannot be set."""
        return bool(self.flags & videodev.CTRL_FLAG_READ_ONLY)

    @property
    def inactive(self) -> bool:
        """Whether it has no effect now, as the camera sets it automatically."""
        return bool(self.flags & videodev.CTRL_FLAG_INACTIVE)

    @property
    def bounds(self) -> str:
        """The values that it accepts, in words."""
        if self.items:
            return ", ".join(f"{value} ({text})" for value, text in sorted(self.items.items()))
        if self.type == videodev.CTRL_TYPE_BITMASK:
            return f"bits of {self.maximum & 0xFFFFFFFF:#x}"
        steps = f" in steps of {self.step}" if self.step > 1 else ""
        return f"{self.minimum} to {self.maximum}{steps}"

    def check(self, value: int) -> None:
        """Raise `ControlRejected` if the control does not accept the value."""
        if self.read_only:
            raise ControlRejected(f"{self.name} is read-only; leave it out")
        if not self._accepts(value):
            raise ControlRejected(f"{self.name} = {value}: the camera accepts {self.bounds}")

    def _accepts(self, value: int) -> bool:
        if self.items:
            return value in self.items
        if self.type == videodev.CTRL_TYPE_BITMASK:
            return not value & ~(self.maximum & 0xFFFFFFFF)
        step = max(self.step, 1)
        return self.minimum <= value <= self.maximum and (value - self.minimum) % step == 0


def plain_name(name: str) -> str:
    """Return a control's name as v4l2-ctl writes it.

    `Exposure Time, Absolute` becomes `exposure_time_absolute`.
    """
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def assign_controls(
    controls: Mapping[str, CameraControl], requested: Mapping[str, int]
) -> list[tuple[CameraControl, int]]:
    """Return controls with their requested values, in the order in which they must be set.

    `controls` are a camera's, by plain name. Raises `ControlRejected` for one that it does not have
    or a value that it does not accept.
    """
    by_id = {control.id: control for control in controls.values()}
    found = []
    for name in sorted(requested, key=_priority):
        control = by_id.get(STANDARD.get(name, -1)) or controls.get(name)
        if control is None:
            raise ControlRejected(
                f"the camera has no control {name}; it has {', '.join(sorted(controls)) or 'none'}"
            )
        control.check(requested[name])
        found.append((control, requested[name]))
    return found


def _priority(name: str) -> int:
    names = list(STANDARD)
    return names.index(name) if name in STANDARD else len(names)
