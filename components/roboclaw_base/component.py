"""The driver of a base on a RoboClaw."""

from __future__ import annotations

import math
import time

from cairn import (
    RELIABLE,
    SENSOR,
    CairnError,
    Component,
    In,
    Out,
    RateLimitedLog,
    every,
    on,
)
from cairn.components.roboclaw_base.client import ControllerHandshake, open_line
from cairn.components.roboclaw_base.config import RoboclawBaseConfig
from cairn.components.roboclaw_base.drive_loop import DriveLoop
from cairn.components.roboclaw_base.health import NOT_CONNECTED, ControllerHealth, RetryShare
from cairn.components.roboclaw_base.messages import (
    AWAITS_REST,
    battery_message,
    diagnostics_message,
    odometry_message,
    odometry_transform,
)
from cairn.components.roboclaw_base.odometry import SpeedAverage, WheelOdometry, WheelStep
from cairn.driver.command_timeout import LatestCommand
from cairn.driver.device_thread import DeviceThread
from cairn.driver.diagnostics import RateWindow
from cairn.driver.errors import DeviceError
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.geometry_msgs import Twist
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.sensor_msgs import BatteryState
from cairn.schemas.tf2_msgs import TFMessage

_PAUSE_S = 0.5  # between two steps: the line was lost


class RoboclawBase(Component):
    """Drives a differential base by a RoboClaw motor controller; publishes wheel odometry.

    The wheels stop when commands are stale, when the component is deactivated, and when the line
    fails. If this process hangs or dies or the cable is unplugged, the controller's own serial
    timeout stops them.
    """

    live_parameters = frozenset()
    clock_source = "device"

    config: RoboclawBaseConfig

    cmd_vel: In[Twist] = In(qos=SENSOR, exclusive=True)
    odom: Out[Odometry] = Out(qos=RELIABLE.with_depth(1000))
    tf: Out[TFMessage]
    battery_state: Out[BatteryState]
    diagnostics: Out[DiagnosticArray]

    _thread: DeviceThread | None = None

    def on_configure(self) -> None:
        """Start at the origin of frame `odom`; check that the RoboClaw is there.

        After a restart it may be missing: then the device thread waits for it.
        """
        config = self.config
        self._odometry = WheelOdometry(config.odometry_noise())
        self._speed = SpeedAverage()
        self._command = LatestCommand(config.command_timeout_s)
        self._health = ControllerHealth()
        self._retries = RetryShare()
        self._rate = RateWindow()
        self._drive_loop = DriveLoop(
            config.drive_settings(),
            lambda: open_line(config.port, config.baud),
            self._command,
            self._health,
            on_ready=self._on_ready,
            on_step=lambda step: self.post(lambda: self._publish_step(step)),
        )
        if not self.restarts:
            try:
                self._drive_loop.check_device()
            except CairnError as error:
                raise CairnError(f"{self.name}: {error}") from error

    def on_activate(self) -> None:
        """Start driving, from rest; an earlier wheel fault is cleared.

        Distances that the wheels turned while it was inactive are found in their counters.
        """
        self._command.clear()
        self._warnings = RateLimitedLog(self.log)
        self._health.wheel_fault, self._health.device_error = None, NOT_CONNECTED
        thread = DeviceThread(
            f"{self.name}: RoboClaw",
            self._drive_loop.serve,
            log=self.log,
            on_device_error=self._on_device_error,
            on_failure=self._on_failure,
        )
        self._thread = thread
        thread.start()

    def on_deactivate(self) -> None:
        """Stop the wheels, wait until they stand, and close the line."""
        self._stop_thread()

    def on_shutdown(self) -> None:
        """Do the same, if it was active."""
        self._stop_thread()

    def on_error(self, _: Exception) -> bool:
        """Stop the wheels."""
        self._stop_thread()
        return False

    @on("cmd_vel")
    def on_cmd_vel(self, command: Twist) -> None:
        """Use a velocity command from now on."""
        self._command.set(time.monotonic(), command.linear.x, command.angular.z)

    @every(hz=1)
    def publish_health(self) -> None:
        """Publish the state of the controller, connected or not."""
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
        if health.device_error is None and not math.isnan(health.voltage):
            self.battery_state.publish(battery_message(now, health))
        self._log_warnings()

    def _publish_step(self, step: WheelStep) -> None:
        if step.seconds > _PAUSE_S:
            self._rate.restart()  # the pause was reported already
        self._rate.note(step.at)
        self._odometry.add(step.distance, step.turn)
        speed = self._speed.add(step.seconds, step.distance, step.turn)
        message = odometry_message(self._odometry, step, speed, self.config.odometry_noise())
        self.odom.publish(message)
        self.tf.publish(TFMessage(transforms=(odometry_transform(message, self._odometry),)))

    def _log_warnings(self) -> None:
        """Log what the operator has to repair."""
        health = self._health
        if health.wheel_fault is not None:
            self._warnings.warn(
                "wheel", f"{health.wheel_fault}; the motors are off until the driver is restarted"
            )
        if health.status.errors:
            errors = ", ".join(health.status.errors)
            self._warnings.warn("status", f"the RoboClaw does not drive: {errors}")
        else:
            self._warnings.resolved("status", "the RoboClaw can drive again")
        if health.awaits_rest and not health.status.errors:
            self._warnings.warn("rest", AWAITS_REST)
        else:
            self._warnings.resolved("rest", "the base follows commands again")

    def _on_ready(self, ready: ControllerHandshake) -> None:
        if self._thread is not None:
            self._thread.report_working(f"{ready.version} on {self.config.port} works again")

    def _on_device_error(self, error: DeviceError) -> None:
        self._health.device_error = str(error)

    def _on_failure(self, error: Exception) -> None:
        """Fail the component, from the device thread, which has ended: it must not be stopped."""
        self._thread = None

        def fail() -> None:
            raise error

        self.post(fail)

    def _stop_thread(self) -> None:
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.stop()
