"""The conversation with a RoboClaw that drives a base: commands out, encoder counts in."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from cairn.components.roboclaw import commands
from cairn.components.roboclaw.commanding import STILL, LatestCommand
from cairn.components.roboclaw.dialogue import Dialogue
from cairn.components.roboclaw.encoder_reading import Counted, EncoderReader
from cairn.components.roboclaw.health import Health, asking
from cairn.components.roboclaw.kinematics import Geometry, Limits, Pair, approached, limited
from cairn.components.roboclaw.setting_up import Ready, set_up
from cairn.components.roboclaw.wheel_watch import WatchLimits, WheelWatch
from cairn.driver.errors import DeviceError
from cairn.driver.link import Link

_STANDS_BELOW = 0.01  # [m/s]: slower than this, and a wheel stands
_STAND_S = 1.0  # for standing still, beyond the time that slowing down takes
_LONGEST_STAND_S = 3.0  # shorter than its supervisor waits for it to stop
_LONGEST_STEP_S = 0.2  # a longer pause between two readings says nothing of speeds
_SHORTEST = 0.6  # of a period, between two readings of the encoders [1]
_FASTER_THAN_POSSIBLE = 2.0  # times the speed at full power: the counter did not count this
_AT_ZERO = 0.02  # [m]: counters that are so near to 0 have begun anew, unless they were before


@dataclass(frozen=True)
class DriveSettings:
    """What the conversation needs to know of base and controller."""

    address: int
    baud: int
    rate_hz: float
    device_timeout_s: float
    geometry: Geometry
    limits: Limits
    watch: WatchLimits
    main_voltages: tuple[float, float] | None


@dataclass(frozen=True)
class Step:
    """How the base has moved between two readings of the encoders."""

    at: float
    """When the second one was taken [s of the monotonic clock]."""
    stamp: int
    """The same by the system's clock, in which all devices live [ns]."""
    seconds: float
    way: float
    turned: float


class Driving:
    """Drives the base over a line, until it is told to stop or the line fails.

    The wheels stand before it begins and when it ends. `converse` is called again after a failure,
    and takes up the way where it was: the counters go on while the controller has power.
    """

    def __init__(
        self,
        settings: DriveSettings,
        open_link: Callable[[], Link],
        command: LatestCommand,
        health: Health,
        on_ready: Callable[[Ready], None],
        on_step: Callable[[Step], None],
    ) -> None:
        """`on_ready` is called at the beginning of a conversation, `on_step` with each step, both
        on the thread that calls `converse`.
        """
        self._settings = settings
        self._open_link = open_link
        self._command = command
        self._health = health
        self._on_ready = on_ready
        self._on_step = on_step
        self._watch = WheelWatch(settings.watch)
        self._last: Counted | None = None
        self._twist: Pair = STILL
        self._unjudged_until = -math.inf

    def look(self) -> Ready:
        """See that the RoboClaw is there and can be used; raises `CairnError`."""
        link = self._open_link()
        try:
            settings = self._settings
            return self._set_up(
                Dialogue(link, settings.address, settings.baud, self._health.counts)
            )
        finally:
            link.close()

    def converse(self, stopping: threading.Event) -> None:
        """Drive until `stopping` is set. Raises `DeviceError` if the device fails."""
        link = self._open_link()
        try:
            settings = self._settings
            dialogue = Dialogue(link, settings.address, settings.baud, self._health.counts)
            encoders = EncoderReader(dialogue)
            ready = self._begin(dialogue, encoders)
            self._on_ready(ready)
            try:
                self._drive(dialogue, encoders, ready, stopping)
            except Exception:
                # Why it ended is raised; if this fails too, the serial timeout stops the wheels.
                with suppress(DeviceError):
                    self._order_still(dialogue)
                raise
            self._stand(dialogue, encoders)
        finally:
            link.close()

    def _begin(self, dialogue: Dialogue, encoders: EncoderReader) -> Ready:
        self._twist = STILL
        self._order_still(dialogue)
        ready = self._set_up(dialogue)
        if not (ready.kept_power and self._counters_went_on(encoders)):
            self._lost_power()
        self._stand(dialogue, encoders)
        self._watch.forget()
        health = self._health
        health.version, health.trouble = ready.version, None
        health.connections += 1
        return ready

    def _counters_went_on(self, encoders: EncoderReader) -> bool:
        """Whether the counters are still those of before.

        The serial timeout alone does not tell: it may have been saved among the settings.
        """
        return self._last is None or self._at_zero(self._last) or not self._at_zero(encoders.read())

    def _at_zero(self, counted: Counted) -> bool:
        ways = self._settings.geometry.wheel_ways(*counted.from_zero())
        return max(map(abs, ways)) < _AT_ZERO

    def _lost_power(self) -> None:
        """Where the wheels have turned meanwhile nobody knows; and it must not set off by itself.

        It may have been an emergency stop that took its power, and has been released.
        """
        if self._last is not None:  # else it has just been connected
            self._health.awaits_rest = True
        self._last = None

    def _set_up(self, dialogue: Dialogue) -> Ready:
        settings = self._settings
        return set_up(
            dialogue,
            settings.geometry,
            settings.limits,
            settings.device_timeout_s,
            settings.main_voltages,
        )

    def _drive(
        self,
        dialogue: Dialogue,
        encoders: EncoderReader,
        ready: Ready,
        stopping: threading.Event,
    ) -> None:
        period = 1.0 / self._settings.rate_hz
        questions = asking(dialogue, self._health, self._settings.device_timeout_s)
        turn_of = 0
        began = due = time.monotonic() - period
        while not stopping.is_set():
            before, began = began, time.monotonic()
            if began - before > 0.5 * self._settings.device_timeout_s:
                # The RoboClaw may have stopped the wheels meanwhile, and commands are old.
                self._twist = STILL
                self._command.doubt(began)
                self._unjudged_until = began + self._settings.limits.slowing_s
            asked = self._order(dialogue, ready, began, min(began - before, 2.0 * period))
            step = self._measure(encoders, ready)
            self._on_step(step)  # at once: the line may fail, and the step is counted
            self._judge(dialogue, asked, step)
            questions[turn_of]()
            turn_of = (turn_of + 1) % len(questions)
            # What was late is made up for, but slowly: speeds of very short steps are noise.
            due = max(due + period, began + _SHORTEST * period)
            stopping.wait(max(0.0, due - time.monotonic()))

    def _order(self, dialogue: Dialogue, ready: Ready, now: float, seconds: float) -> Pair:
        """Send what the wheels are to do; the speeds that were asked of them [m/s]."""
        settings, geometry = self._settings, self._settings.geometry
        wanted = self._wanted(now)
        wheels = geometry.wheel_speeds(*wanted)
        wanted = limited(*wanted, settings.limits, wheels, ready.fastest_wheel)
        self._twist = approached(self._twist, wanted, settings.limits, seconds)
        if self._health.fault is not None:
            self._twist = STILL
            dialogue.order(commands.switch_off())
            return STILL
        asked = geometry.wheel_speeds(*self._twist)
        dialogue.order(
            commands.drive_speed(self._wheel_acceleration(), *geometry.channel_counts(*asked))
        )
        return asked

    def _wanted(self, now: float) -> Pair:
        """The command, unless the controller cannot carry it out, or has just become able to.

        When an emergency stop is released, the base must not start of its own accord: the command
        has to be rest once.
        """
        wanted = self._command.take(now)
        if self._health.status.errors:
            self._health.awaits_rest = True
            self._twist = STILL
        elif wanted == STILL:
            self._health.awaits_rest = False
        return STILL if self._health.awaits_rest else wanted

    def _measure(self, encoders: EncoderReader, ready: Ready) -> Step:
        now = encoders.read()
        before = self._last or now
        seconds = now.at - before.at
        geometry = self._settings.geometry
        first, second = now.since(before)
        ways = geometry.wheel_ways(first, second)
        possible = _FASTER_THAN_POSSIBLE * ready.fastest_wheel * seconds + 0.05
        self._last = now
        if max(map(abs, ways)) > possible:
            self._lost_power()
            raise DeviceError(
                f"the encoder counts jumped by {first} and {second} within {seconds:.3f} s: the "
                "RoboClaw was switched off and on, or another program resets them"
            )
        way, turned = geometry.twist(*ways)
        return Step(now.at, now.stamp, seconds, way, turned)

    def _judge(self, dialogue: Dialogue, asked: Pair, step: Step) -> None:
        if self._health.fault is not None:
            return
        excused = self._health.status.errors or step.at < self._unjudged_until
        if excused or not 0.0 < step.seconds < _LONGEST_STEP_S:
            self._watch.forget()
            return
        geometry = self._settings.geometry
        seen = geometry.wheel_speeds(step.way / step.seconds, step.turned / step.seconds)
        self._health.fault = self._watch.judge(step.at, asked, seen)
        if self._health.fault is not None:
            dialogue.order(commands.switch_off())

    def _stand(self, dialogue: Dialogue, encoders: EncoderReader) -> None:
        """Have the wheels stand still, and see that they do."""
        settings = self._settings
        period = 1.0 / settings.rate_hz
        limit_s = min(settings.limits.slowing_s + _STAND_S, _LONGEST_STAND_S)
        until = time.monotonic() + limit_s
        before = encoders.read()
        still = 0
        while still < 2:
            if time.monotonic() > until:
                dialogue.order(commands.switch_off())
                raise DeviceError(
                    f"the wheels do not stand still within {limit_s:.1f} s of "
                    "being told to; the motors are switched off"
                )
            self._order_still(dialogue)
            time.sleep(period)  # also when it is to end: the wheels come first
            now = encoders.read()
            ways = settings.geometry.wheel_ways(*now.since(before))
            still = still + 1 if max(map(abs, ways)) <= _STANDS_BELOW * (now.at - before.at) else 0
            before = now

    def _order_still(self, dialogue: Dialogue) -> None:
        if self._health.fault is not None:
            dialogue.order(commands.switch_off())
        else:
            dialogue.order(commands.drive_speed(self._wheel_acceleration(), 0, 0))

    def _wheel_acceleration(self) -> int:
        """Of any wheel at most [counts/s^2]; the speeds sent are those of a slower ramp already."""
        settings, geometry = self._settings, self._settings.geometry
        most = settings.limits.wheel_acceleration(geometry.separation)
        counts = max(abs(counts) for counts in geometry.channel_counts(most, most))
        return min(max(counts, 1), commands.HIGHEST_ACCELERATION)
