"""The drive loop of a base: velocity commands to a RoboClaw, encoder counts from it.

It stops the wheels when commands are stale, when it is stopped, and when the
line fails; it switches the motors off when a wheel is at fault (`wheel_faults`).
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from cairn.components.roboclaw_base import protocol
from cairn.components.roboclaw_base.client import (
    ControllerHandshake,
    EncoderReader,
    EncoderReading,
    RoboclawClient,
    handshake,
)
from cairn.components.roboclaw_base.health import ControllerHealth, health_polls
from cairn.components.roboclaw_base.kinematics import (
    BaseLimits,
    Pair,
    WheelGeometry,
    limit_velocity,
    ramp_velocity,
)
from cairn.components.roboclaw_base.odometry import WheelStep
from cairn.components.roboclaw_base.wheel_faults import WheelFaultDetector, WheelFaultLimits
from cairn.driver.command_timeout import REST, LatestCommand
from cairn.driver.errors import DeviceError
from cairn.driver.serial_and_tcp import Link

_STANDSTILL_SPEED = 0.01  # [m/s]: a slower wheel stands
_STANDSTILL_S = 1.0  # for coming to rest, in addition to the time that slowing down takes
_LONGEST_STANDSTILL_S = 3.0  # shorter than the supervisor waits for the component to stop
_LONGEST_STEP_S = 0.2  # a longer pause between two readings gives no speed to judge
_SHORTEST_PERIOD = 0.6  # of a period, between two readings of the encoders [1]
_IMPOSSIBLE_FACTOR = 2.0  # times the speed at full power: the counter did not count this
_AT_ZERO = 0.02  # [m]: counters this close to 0 were reset, unless they were so before


@dataclass(frozen=True)
class DriveSettings:
    """What the drive loop needs to know of base and controller."""

    address: int
    baud: int
    rate_hz: float
    device_timeout_s: float
    geometry: WheelGeometry
    limits: BaseLimits
    faults: WheelFaultLimits
    main_voltages: tuple[float, float] | None


class DriveLoop:
    """Drives the base over a line until it is stopped or the line fails.

    The wheels stand before it starts and when it ends. `serve` is called again after a failure, and
    odometry goes on where it was: the counters go on while the controller has power.
    """

    def __init__(
        self,
        settings: DriveSettings,
        open_link: Callable[[], Link],
        command: LatestCommand,
        health: ControllerHealth,
        on_ready: Callable[[ControllerHandshake], None],
        on_step: Callable[[WheelStep], None],
    ) -> None:
        """`on_ready` is called after each handshake, `on_step` for each step, both on the thread
        that calls `serve`.
        """
        self._settings = settings
        self._open_link = open_link
        self._command = command
        self._health = health
        self._on_ready = on_ready
        self._on_step = on_step
        self._fault_detector = WheelFaultDetector(settings.faults)
        self._last: EncoderReading | None = None
        self._velocity: Pair = REST
        self._not_judged_until = -math.inf

    def check_device(self) -> ControllerHandshake:
        """Check that the RoboClaw is there and can be used; raises `CairnError`."""
        link = self._open_link()
        try:
            return self._handshake(self._client(link))
        finally:
            link.close()

    def serve(self, stopping: threading.Event) -> None:
        """Drive until `stopping` is set. Raises `DeviceError` if the device fails."""
        link = self._open_link()
        try:
            client = self._client(link)
            encoders = EncoderReader(client)
            ready = self._start(client, encoders)
            self._on_ready(ready)
            try:
                self._drive(client, encoders, ready, stopping)
            except Exception:
                # The cause is raised; if this fails too, the serial timeout stops the wheels.
                with suppress(DeviceError):
                    self._command_rest(client)
                raise
            self._stop_wheels(client, encoders)
        finally:
            link.close()

    def _client(self, link: Link) -> RoboclawClient:
        settings = self._settings
        return RoboclawClient(link, settings.address, settings.baud, self._health.counts)

    def _start(self, client: RoboclawClient, encoders: EncoderReader) -> ControllerHandshake:
        self._velocity = REST
        self._command_rest(client)
        ready = self._handshake(client)
        if not (ready.kept_power and self._counters_went_on(encoders)):
            self._note_power_loss()
        self._stop_wheels(client, encoders)
        self._fault_detector.reset()
        health = self._health
        health.version, health.device_error = ready.version, None
        health.connections += 1
        return ready

    def _counters_went_on(self, encoders: EncoderReader) -> bool:
        """Return whether the counters were not reset since the last reading.

        The serial timeout alone does not show that: it may have been saved in the settings.
        """
        return self._last is None or self._at_zero(self._last) or not self._at_zero(encoders.read())

    def _at_zero(self, reading: EncoderReading) -> bool:
        distances = self._settings.geometry.wheel_distances(*reading.from_zero())
        return max(map(abs, distances)) < _AT_ZERO

    def _note_power_loss(self) -> None:
        """Start a new count, and do not drive before the command was rest once.

        How far the wheels have turned meanwhile is unknown; and the power may have been switched
        off by an emergency stop that was released since.
        """
        if self._last is not None:  # else this is the first connection
            self._health.awaits_rest = True
        self._last = None

    def _handshake(self, client: RoboclawClient) -> ControllerHandshake:
        settings = self._settings
        return handshake(
            client,
            settings.geometry,
            settings.limits,
            settings.device_timeout_s,
            settings.main_voltages,
        )

    def _drive(
        self,
        client: RoboclawClient,
        encoders: EncoderReader,
        ready: ControllerHandshake,
        stopping: threading.Event,
    ) -> None:
        period = 1.0 / self._settings.rate_hz
        polls = health_polls(client, self._health, self._settings.device_timeout_s)
        next_poll = 0
        started = due = time.monotonic() - period
        while not stopping.is_set():
            before, started = started, time.monotonic()
            if started - before > 0.5 * self._settings.device_timeout_s:
                # The RoboClaw may have stopped the wheels meanwhile, and queued commands are old.
                self._velocity = REST
                self._command.ignore_queued(started)
                self._not_judged_until = started + self._settings.limits.stopping_s
            commanded = self._send_command(
                client, ready, started, min(started - before, 2.0 * period)
            )
            step = self._measure(encoders, ready)
            self._on_step(step)  # before anything else: the line may fail, and the step is counted
            self._judge_wheels(client, commanded, step)
            polls[next_poll]()
            next_poll = (next_poll + 1) % len(polls)
            # A delay is made up for, but slowly: speeds of very short steps are noisy.
            due = max(due + period, started + _SHORTEST_PERIOD * period)
            stopping.wait(max(0.0, due - time.monotonic()))

    def _send_command(
        self, client: RoboclawClient, ready: ControllerHandshake, now: float, seconds: float
    ) -> Pair:
        """Send the next velocity to the wheels; return the wheel speeds [m/s] commanded."""
        settings, geometry = self._settings, self._settings.geometry
        target = self._target(now)
        wheels = geometry.wheel_speeds(*target)
        target = limit_velocity(*target, settings.limits, wheels, ready.fastest_wheel)
        self._velocity = ramp_velocity(self._velocity, target, settings.limits, seconds)
        if self._health.wheel_fault is not None:
            self._velocity = REST
            client.write(protocol.switch_off())
            return REST
        commanded = geometry.wheel_speeds(*self._velocity)
        counts = geometry.channel_counts(*commanded)
        client.write(protocol.drive_speed(self._wheel_acceleration(), *counts))
        return commanded

    def _target(self, now: float) -> Pair:
        """Return the command, or rest if the controller cannot drive or has just become able to.

        When an emergency stop is released, the base must not start moving by itself: the command
        must be rest once.
        """
        target = self._command.fresh(now) or REST
        if self._health.status.errors:
            self._health.awaits_rest = True
            self._velocity = REST
        elif target == REST:
            self._health.awaits_rest = False
        return REST if self._health.awaits_rest else target

    def _measure(self, encoders: EncoderReader, ready: ControllerHandshake) -> WheelStep:
        now = encoders.read()
        before = self._last or now
        seconds = now.at - before.at
        geometry = self._settings.geometry
        first, second = now.since(before)
        distances = geometry.wheel_distances(first, second)
        possible = _IMPOSSIBLE_FACTOR * ready.fastest_wheel * seconds + 0.05
        self._last = now
        if max(map(abs, distances)) > possible:
            self._note_power_loss()
            raise DeviceError(
                f"the encoder counts jumped by {first} and {second} within {seconds:.3f} s: the "
                "RoboClaw was switched off and on, or another program resets them; check its power "
                "and close other programs"
            )
        distance, turn = geometry.body_motion(*distances)
        return WheelStep(now.at, now.stamp, seconds, distance, turn)

    def _judge_wheels(self, client: RoboclawClient, commanded: Pair, step: WheelStep) -> None:
        if self._health.wheel_fault is not None:
            return
        excused = self._health.status.errors or step.at < self._not_judged_until
        if excused or not 0.0 < step.seconds < _LONGEST_STEP_S:
            self._fault_detector.reset()
            return
        measured = self._settings.geometry.wheel_speeds(
            step.distance / step.seconds, step.turn / step.seconds
        )
        self._health.wheel_fault = self._fault_detector.check(step.at, commanded, measured)
        if self._health.wheel_fault is not None:
            client.write(protocol.switch_off())

    def _stop_wheels(self, client: RoboclawClient, encoders: EncoderReader) -> None:
        """Command rest, and wait until the encoders stand still."""
        settings = self._settings
        period = 1.0 / settings.rate_hz
        limit_s = min(settings.limits.stopping_s + _STANDSTILL_S, _LONGEST_STANDSTILL_S)
        deadline = time.monotonic() + limit_s
        before = encoders.read()
        still = 0
        while still < 2:
            if time.monotonic() > deadline:
                client.write(protocol.switch_off())
                raise DeviceError(
                    f"the wheels do not stand still within {limit_s:.1f} s of the command to stop; "
                    "the motors are switched off: check the speed loops and the encoders"
                )
            self._command_rest(client)
            time.sleep(period)  # even while stopping: the wheels come first
            now = encoders.read()
            distances = settings.geometry.wheel_distances(*now.since(before))
            slow = max(map(abs, distances)) <= _STANDSTILL_SPEED * (now.at - before.at)
            still = still + 1 if slow else 0
            before = now

    def _command_rest(self, client: RoboclawClient) -> None:
        if self._health.wheel_fault is not None:
            client.write(protocol.switch_off())
        else:
            client.write(protocol.drive_speed(self._wheel_acceleration(), 0, 0))

    def _wheel_acceleration(self) -> int:
        """Return the limit for any wheel [counts/s^2]; the speeds sent follow a slower ramp."""
        settings, geometry = self._settings, self._settings.geometry
        highest = settings.limits.wheel_acceleration(geometry.separation)
        counts = max(abs(count) for count in geometry.channel_counts(highest, highest))
        return min(max(counts, 1), protocol.HIGHEST_ACCELERATION)
