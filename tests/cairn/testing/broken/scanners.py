"""A correct driver of a fictitious scanner, and drivers that differ from it by one mistake each.

The device is a file: it is plugged in while the file exists.
"""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from pathlib import Path
from subprocess import Popen

import numpy as np
from pydantic import Field

from cairn import SECOND, SENSOR, CairnError, Component, Config, Out, every, from_ns
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from tests.cairn.testing.broken.periods import Periods

BEAMS = 181
STEP = math.pi / (BEAMS - 1)
SWEEP_S = 0.045
SWEEP_NS = round(SWEEP_S * SECOND)
RATE_HZ = 20.0
SURROUNDINGS = {math.radians(90.0): 1.0, 0.0: 2.0, math.radians(-90.0): 3.0}


def loss_of(device: Path) -> Path:
    """Return the file that a driver creates when it notices that its device is gone."""
    return device.with_suffix(".lost")


class CorrectScannerConfig(Config):
    device: Path = Field(description="File that exists while the device is plugged in.")


class CorrectScanner(Component):
    """Has no mistake."""

    config: CorrectScannerConfig
    scan: Out[LaserScan] = Out(qos=SENSOR)

    def on_configure(self) -> None:
        self._plugged_in = True

    def on_activate(self) -> None:
        self.turns = Periods(self.clock.now(), RATE_HZ)

    @every(hz=RATE_HZ)
    def measure(self) -> None:
        plugged_in = self.config.device.exists()
        if self._plugged_in and not plugged_in:
            loss_of(self.config.device).touch()
            self.on_unplugged()
        self._plugged_in = plugged_in
        for _ in self.turns.completed(self.clock.now()):
            if plugged_in:
                self.send()

    def on_unplugged(self) -> None:
        self.log.warning("%s is gone", self.config.device)

    def send(self) -> None:
        self.scan.publish(self.measured_scan())

    def measured_scan(self) -> LaserScan:
        """Return the surroundings: 1 m on the left, 2 m ahead, 3 m on the right."""
        bearings = -math.pi / 2 + np.arange(BEAMS) * STEP
        ranges = np.interp(bearings, sorted(SURROUNDINGS), [3.0, 2.0, 1.0])
        return LaserScan(
            header=Header(stamp=from_ns(self.turns.ended - SWEEP_NS), frame_id="laser"),
            angle_min=-math.pi / 2,
            angle_max=math.pi / 2,
            angle_increment=STEP,
            time_increment=SWEEP_S / (BEAMS - 1),
            scan_time=1.0 / RATE_HZ,
            range_min=0.1,
            range_max=10.0,
            ranges=ranges.astype(np.float32),
        )

    def scan_stamped(self, ns: int) -> LaserScan:
        scan = CorrectScanner.measured_scan(self)
        return replace(scan, header=replace(scan.header, stamp=from_ns(ns)))


class Millimeters(CorrectScanner):
    """Publishes the device's millimeters as meters."""

    def measured_scan(self) -> LaserScan:
        scan = super().measured_scan()
        return replace(scan, ranges=scan.ranges * np.float32(1000.0))


class MillimeterLimits(CorrectScanner):
    """Publishes the device's millimeters as meters, its limits too."""

    def measured_scan(self) -> LaserScan:
        scan = super().measured_scan()
        return replace(
            scan,
            ranges=scan.ranges * np.float32(1000.0),
            range_min=scan.range_min * 1000.0,
            range_max=scan.range_max * 1000.0,
        )


class Clockwise(CorrectScanner):
    """Publishes the device's beams in their order of arrival, which is to the right."""

    def measured_scan(self) -> LaserScan:
        scan = super().measured_scan()
        return replace(scan, ranges=scan.ranges[::-1].copy())


class Degrees(CorrectScanner):
    """Publishes the first angle in degrees; an increment in degrees makes no valid message."""

    def measured_scan(self) -> LaserScan:
        scan = super().measured_scan()
        last = -90.0 + (scan.ranges.size - 1) * scan.angle_increment
        return replace(scan, angle_min=-90.0, angle_max=last)


class TooFar(CorrectScanner):
    """Publishes "no return" as the number 65.533 that the device sends."""

    def measured_scan(self) -> LaserScan:
        scan = super().measured_scan()
        ranges = scan.ranges.copy()
        ranges[20:60] = 65.533
        return replace(scan, ranges=ranges)


class StampedWhenSent(CorrectScanner):
    """Stamps a scan when all of it has arrived."""

    def measured_scan(self) -> LaserScan:
        return replace(
            super().measured_scan(),
            header=Header(stamp=from_ns(self.turns.ended), frame_id="laser"),
        )


class StampsJump(CorrectScanner):
    """Stamps with the time at which the operating system delivered the bytes."""

    def send(self) -> None:
        late = round((0.0, 0.02, 0.02, 0.0)[self.turns.number % 4] * SECOND)
        self.scan.publish(self.scan_stamped(self.turns.ended - SWEEP_NS - late))


class StampsOfAnotherClock(CorrectScanner):
    """Stamps by the device's clock, which is an hour behind."""

    def send(self) -> None:
        self.scan.publish(self.scan_stamped(self.turns.ended - 3600 * SECOND))


class OtherFrame(CorrectScanner):
    """Its frame is misspelled."""

    def measured_scan(self) -> LaserScan:
        scan = super().measured_scan()
        return replace(scan, header=replace(scan.header, frame_id="/laser_link"))


class EveryOther(CorrectScanner):
    """Loses every other scan."""

    def send(self) -> None:
        if self.turns.number % 2:
            super().send()


class NeverSilent(CorrectScanner):
    """A thread of its own publishes, active or not."""

    def on_configure(self) -> None:
        super().on_configure()
        self._stopping = threading.Event()
        node = self._context.node  # bypasses the port
        self._publisher = node.advertise(self.scan.topic, LaserScan, SENSOR)
        self._thread = threading.Thread(target=self._stream, daemon=True)
        self._thread.start()

    def on_cleanup(self) -> None:
        self._stopping.set()
        self._thread.join()
        self._publisher.close()

    def send(self) -> None:
        pass

    def _stream(self) -> None:
        while not self._stopping.wait(1.0 / RATE_HZ):
            if self.config.device.exists():
                self.turns = Periods(self.clock.now(), RATE_HZ)
                self._publisher.publish(self.measured_scan())


class Leaks(CorrectScanner):
    """Releases nothing that it allocates."""

    def on_configure(self) -> None:
        super().on_configure()
        self._open = [*getattr(self, "_open", []), self.config.device.open("rb")]
        self._buffers = [*getattr(self, "_buffers", []), np.ones(500_000)]
        self._helpers = [*getattr(self, "_helpers", []), Popen(["sleep", "60"])]

    def on_activate(self) -> None:
        super().on_activate()
        threading.Thread(target=threading.Event().wait, daemon=True).start()

    def on_shutdown(self) -> None:
        for helper in self._helpers:
            helper.kill()
            helper.wait()


class KeepsItsPort(CorrectScanner):
    """Locks its device, and does not unlock it before it configures again."""

    def on_configure(self) -> None:
        super().on_configure()
        if hasattr(self, "_locked"):
            raise CairnError(f"{self.config.device} is locked by another driver")
        self._locked = True


class UnboundedConfig(CorrectScannerConfig):
    power: float = Field(1.0, description="Power of the laser [1].")


class Unbounded(CorrectScanner):
    """Accepts any number for a parameter."""

    config: UnboundedConfig


class HangsAtItsEnd(CorrectScanner):
    """Waits at shutdown for a reply of its device that never arrives."""

    def on_shutdown(self) -> None:
        threading.Event().wait()


class DiesUnplugged(CorrectScanner):
    """Fails when its device is unplugged."""

    def on_unplugged(self) -> None:
        raise CairnError(f"{self.config.device} is gone")


class SilentUnplugged(CorrectScanner):
    """Waits for its device's return without a warning."""

    def on_unplugged(self) -> None:
        pass


class RepeatsUnplugged(CorrectScanner):
    """Continues to publish its last scan."""

    @every(hz=RATE_HZ)
    def repeat(self) -> None:
        if not self.config.device.exists():
            self.send()


class NeverReturns(CorrectScanner):
    """Does not try to reopen its device."""

    def on_unplugged(self) -> None:
        super().on_unplugged()
        self._given_up = True

    def send(self) -> None:
        if not getattr(self, "_given_up", False):
            super().send()
