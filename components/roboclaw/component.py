"""The driver of a base on a RoboClaw."""

from __future__ import annotations

import math
import time

from cairn import (
    RELIABLE,
    SENSOR,
    CairnError,
    Component,
    Config,
    In,
    Out,
    ParameterRejected,
    RateLimitedLog,
    every,
    on,
)
from cairn.components.roboclaw.commanding import LatestCommand
from cairn.components.roboclaw.config import RoboclawBaseConfig
from cairn.components.roboclaw.driving import Driving, Step
from cairn.components.roboclaw.health import Health, RetryShare
from cairn.components.roboclaw.lines import open_line
from cairn.components.roboclaw.messages import (
    AWAITS_REST,
    battery_message,
    diagnostics_message,
    odometry_message,
    odometry_transform,
)
from cairn.components.roboclaw.odometry import RecentSpeed, WheelOdometry
from cairn.components.roboclaw.setting_up import Ready
from cairn.driver.device_thread import DeviceThread
from cairn.driver.diagnostics import RateWindow
from cairn.driver.errors import DeviceError
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.geometry_msgs import Twist
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.sensor_msgs import BatteryState
from cairn.schemas.tf2_msgs import TFMessage

_PAUSE_S = 0.5  # between steps: the line was gone


class RoboclawBase(Component):
    """Drives a differential base by a RoboClaw motor controller; tells what its encoders count.

    The wheels stop when commands go stale, when it is deactivated, and when the line fails; and if
    this process hangs, dies or is unplugged, by the controller's own serial timeout.
    """

    clock_source = "device"

    config: RoboclawBaseConfig

    cmd_vel: In[Twist] = In(qos=SENSOR)
    odom: Out[Odometry] = Out(qos=RELIABLE.with_depth(1000))
    tf: Out[TFMessage]
    battery_state: Out[BatteryState]
    diagnostics: Out[DiagnosticArray]

    _thread: DeviceThread | None = None

    def on_configure(self) -> None:
        """Begin at the origin of the frame `odom`; see that the RoboClaw is there.

        One that was there before may come back: then it is waited for.
        """
        config = self.config
        self._odometry = WheelOdometry(config.odometry_errors())
        self._speed = RecentSpeed()
        self._command = LatestCommand(config.command_timeout_s)
        self._health = Health()
        self._retries = RetryShare()
        self._rate = RateWindow()
        self._driving = Driving(
            config.drive_settings(),
            lambda: open_line(config.port, config.baud),
            self._command,
            self._health,
            on_ready=self._ready,
            on_step=lambda step: self.post(lambda: self._moved(step)),
        )
        if not self.restarts:
            try:
                self._driving.look()
            except CairnError as error:
                raise CairnError(f"{self.name}: {error}") from error

    def on_activate(self) -> None:
        """Begin to drive, at rest; what was wrong with a wheel is forgotten.

        What the wheels have turned meanwhile is found in their counters.
        """
        self._command.forget()
        self._warnings = RateLimitedLog(self.log)
        self._health.fault, self._health.trouble = None, "it is not connected yet"
        thread = DeviceThread(
            f"{self.name}: RoboClaw",
            self._driving.converse,
            log=self.log,
            on_device_error=self._in_trouble,
            on_failure=self._failed,
        )
        self._thread = thread
        thread.start()

    def on_deactivate(self) -> None:
        """Stop the wheels, see that they stand, and let go of the line."""
        self._let_go()

    def on_shutdown(self) -> None:
        """The same, if it was active."""
        self._let_go()

    def on_error(self, error: Exception) -> bool:  # noqa: ARG002 - whatever it was
        """Stop the wheels."""
        self._let_go()
        return False

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """A base stays the one that it is."""
        raise ParameterRejected("the base takes its parameters when it is configured")

    @on("cmd_vel")
    def obey(self, command: Twist) -> None:
        """Take a command, to be carried out from now on."""
        self._command.give(time.monotonic(), command.linear.x, command.angular.z)

    @every(hz=1)
    def report(self) -> None:
        """Tell how the controller is, whether there is one or not."""
        health, now = self._health, self.clock.now()
        self.diagnostics.publish(
            diagnostics_message(
                now,
                self.name,
                self.config.port,
                health,
                self._retries.since_last(health.counts),
                self._rate.hz(time.monotonic()),
                self.config.rate,
            )
        )
        if health.trouble is None and not math.isnan(health.voltage):
            self.battery_state.publish(battery_message(now, health))
        self._complain()

    def _moved(self, step: Step) -> None:
        if step.seconds > _PAUSE_S:
            self._rate.restart()  # the pause is told of already
        self._rate.note(step.at)
        self._odometry.add(step.way, step.turned)
        speed = self._speed.add(step.seconds, step.way, step.turned)
        message = odometry_message(self._odometry, step, speed, self.config.odometry_errors())
        self.odom.publish(message)
        self.tf.publish(TFMessage(transforms=(odometry_transform(message, self._odometry),)))

    def _complain(self) -> None:
        """Log what the operator has to see to."""
        health = self._health
        if health.fault is not None:
            self._warnings.warn("wheel", f"{health.fault}; the motors are off until a restart")
        if health.status.errors:
            what = ", ".join(health.status.errors)
            self._warnings.warn("status", f"the RoboClaw does not drive: {what}")
        else:
            self._warnings.resolved("status", "the RoboClaw can drive again")
        if health.awaits_rest and not health.status.errors:
            self._warnings.warn("rest", AWAITS_REST)
        else:
            self._warnings.resolved("rest", "the base goes where it is commanded again")

    def _ready(self, ready: Ready) -> None:
        if self._thread is not None:
            self._thread.report_working(f"{ready.version} on {self.config.port} works again")

    def _in_trouble(self, error: DeviceError) -> None:
        self._health.trouble = str(error)

    def _failed(self, error: Exception) -> None:
        """Fail, on the device's thread: its conversation has ended, and nothing is to be ended."""
        self._thread = None

        def fail() -> None:
            raise error

        self.post(fail)

    def _let_go(self) -> None:
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.stop()
