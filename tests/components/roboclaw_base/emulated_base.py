"""A base on an emulated RoboClaw, for tests: deployment, faults, the true motion of its wheels."""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cairn.components.roboclaw_base.emulator import EmulatedRoboclaw, TrueMotion
from cairn.driver.emulator import Emulator
from cairn.driver.emulator_lines import PtyEnd
from cairn.planar.poses import Pose, compose
from tests.patience import LIMIT_S

RADIUS, SEPARATION, COUNTS = 0.05, 0.3, 4000.0
PARAMETERS = {
    "wheel_radius": RADIUS,
    "wheel_separation": SEPARATION,
    "counts_per_turn": COUNTS,
    "right_inverted": True,
}
DEPLOYMENT = """
    settings: {port: ""}
    external_topics: [cmd_vel]
    components:
      base:
        plugin: roboclaw_base
        parameters:
          port: "${port}"
          wheel_radius: 0.05
          wheel_separation: 0.3
          counts_per_turn: 4000
          right_inverted: true
          rate: 20
          acceleration: 3.0
          turn_acceleration: 20.0
          speed: 0.8
          turn: 4.0
          device_timeout_s: 1.0
    """
"""One base; its driver counts across the wrap of the left encoder's counter."""

_METERS = 2.0 * math.pi * RADIUS / COUNTS
_STANDSTILL_SPEED = 0.01  # [m/s]


class ObservedBase(ABC):
    """The controller, and what its wheels do, in real or in virtual time."""

    def __init__(self) -> None:
        self.device = EmulatedRoboclaw(full_speed=30_000.0, first_counts=(2**32 - 500, 300))

    @abstractmethod
    def call(self, function: Callable[[], object]) -> None:
        """Call a function between the controller's steps."""

    @abstractmethod
    def monotonic(self) -> float:
        """Return the time [s]."""

    @abstractmethod
    def pause(self) -> None:
        """Let some time pass."""

    def turns(self) -> bool:
        return self.speed() > _STANDSTILL_SPEED

    def await_stand(self, limit_s: float) -> bool:
        return self.await_that(lambda: not self.turns(), limit_s)

    def await_that(self, condition: Callable[[], bool], limit_s: float = LIMIT_S) -> bool:
        """Wait for a condition; return whether it held within the limit [s]."""
        deadline = self.monotonic() + limit_s
        while not condition():
            if self.monotonic() > deadline:
                return False
            self.pause()
        return True

    def speed(self) -> float:
        """Return the present speed of the faster wheel [m/s], independent of the line."""
        speeds: list[float] = []

        def read() -> None:
            self.device.advance(self.monotonic())
            speeds.extend(abs(motor.speed) for motor in self.device.controller.motors)

        self.call(read)
        return max(speeds) * _METERS

    def motions(self) -> list[TrueMotion]:
        """Return the motion of the wheels so far."""
        steps: list[TrueMotion] = []
        self.call(lambda: steps.extend(self.device.motions))
        return steps

    def fastest_since(self, time_s: float) -> float:
        """Return the highest speed of the faster wheel since a monotonic time [m/s]."""
        speeds = (max(map(abs, step.speeds)) for step in self.motions() if step.time >= time_s)
        return max(speeds, default=0.0) * _METERS

    def true_pose(self) -> Pose:
        """Integrate the true motion of the wheels from the start: m1 left, m2 inverted."""
        pose: Pose = (0.0, 0.0, 0.0)
        left = right = 0.0
        for step in self.motions():
            now_left, now_right = step.turned[0] * _METERS, -step.turned[1] * _METERS
            distance = 0.5 * (now_left - left + now_right - right)
            turned = (now_right - right - (now_left - left)) / SEPARATION
            half = (0.0, 0.0, 0.5 * turned)
            pose = compose(compose(compose(pose, half), (distance, 0.0, 0.0)), half)
            left, right = now_left, now_right
        return pose


class EmulatedBase(ObservedBase):
    """The controller on a pseudo-terminal: a device as `cairn.testing.device` describes it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self.emulator = Emulator(self.device, PtyEnd(path))

    @property
    def settings(self) -> Mapping[str, Any]:
        return {"port": str(self.path)}

    def unplug(self) -> None:
        self.emulator.unplug()

    def plug_in(self) -> None:
        self.emulator.plug_in()

    def call(self, function: Callable[[], object]) -> None:
        self.emulator.call(function)

    def monotonic(self) -> float:
        return time.monotonic()

    def pause(self) -> None:
        time.sleep(0.005)


@contextmanager
def emulated_base(folder: Path) -> Iterator[EmulatedBase]:
    """Run an emulated base that is plugged in for the time of the context."""
    base = EmulatedBase(folder / "roboclaw")
    with base.emulator:
        yield base
