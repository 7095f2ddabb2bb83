"""What a base tells of itself, as messages: odometry, battery, diagnostics."""

from __future__ import annotations

import numpy as np

from cairn import from_ns
from cairn.components.roboclaw.driving import Step
from cairn.components.roboclaw.health import Health
from cairn.components.roboclaw.odometry import OdometryErrors, WheelOdometry
from cairn.driver.diagnostics import ERROR, OK, WARN, diagnostics
from cairn.planar.messages import transform_message, with_covariance
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.geometry_msgs import TransformStamped, Twist, TwistWithCovariance, Vector3
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.sensor_msgs import BatteryState
from cairn.schemas.std_msgs import Header

_ODOM, _BASE = "odom", "base_link"  # frames
_FORWARD, _TURN = 0, 35  # where their variances stand in a row-major 6 x 6
_SLOW = 0.8  # of the nominal rate: slower is told
_RETRIED = 0.02  # of the packets lately: more is told

AWAITS_REST = (
    "the motors were off: the base stands until the command has been rest, or has ceased, once"
)


def odometry_message(
    odometry: WheelOdometry, step: Step, speed: tuple[float, float], errors: OdometryErrors
) -> Odometry:
    """The pose at the end of a step, and the speed [m/s, rad/s]."""
    seconds = step.seconds or 1.0
    covariance = np.zeros(36)
    # The random walks of a step, as speeds.
    covariance[_FORWARD] = errors.way**2 * abs(step.way) / seconds**2
    covariance[_TURN] = (
        errors.turn**2 * abs(step.turned) + errors.turn_per_meter**2 * abs(step.way)
    ) / seconds**2
    twist = Twist(linear=Vector3(x=speed[0]), angular=Vector3(z=speed[1]))
    return Odometry(
        header=Header(stamp=from_ns(step.stamp), frame_id=_ODOM),
        child_frame_id=_BASE,
        pose=with_covariance(odometry.pose, odometry.covariance),
        twist=TwistWithCovariance(twist=twist, covariance=covariance),
    )


def odometry_transform(message: Odometry, odometry: WheelOdometry) -> TransformStamped:
    """The same pose as a transform."""
    return transform_message(message.header, _BASE, odometry.pose)


def battery_message(stamp: int, health: Health) -> BatteryState:
    """The main battery: voltage, and the current of both motors, which discharges it."""
    return BatteryState(
        header=Header(stamp=from_ns(stamp), frame_id=_BASE),
        voltage=health.voltage,
        current=-sum(abs(current) for current in health.currents),
        present=True,
    )


def diagnostics_message(
    now: int, name: str, port: str, health: Health, retried: float, rate: float, nominal: float
) -> DiagnosticArray:
    """How the controller is.

    `retried`: the share of packets sent again lately [1]; `rate`: of the odometry [Hz], against
    the nominal one.
    """
    level, message = _judged(health, retried, rate, nominal)
    counts = health.counts
    values = {
        "port": port,
        "rate [Hz]": rate,
        "nominal rate [Hz]": nominal,
        "main battery [V]": health.voltage,
        "current of M1 [A]": health.currents[0],
        "current of M2 [A]": health.currents[1],
        "temperature [deg C]": health.temperature,
        "errors": ", ".join(health.status.errors) or "none",
        "warnings": ", ".join(health.status.warnings) or "none",
        "wheel fault": health.fault or "none",
        "connections": health.connections,
        "packets": counts.packets,
        "packets sent again": counts.retries,
        "replies missing": counts.silent,
        "replies garbled": counts.garbled,
    }
    return diagnostics(now, name, health.version, level, message, values)


def _judged(health: Health, retried: float, rate: float, nominal: float) -> tuple[int, str]:
    if health.trouble is not None:
        return ERROR, health.trouble
    if health.fault is not None:
        return ERROR, f"{health.fault}; the motors are off until the driver is restarted"
    if health.status.errors:
        return ERROR, f"the RoboClaw does not drive: {', '.join(health.status.errors)}"
    if health.status.warnings:
        return WARN, f"the RoboClaw warns: {', '.join(health.status.warnings)}"
    if rate < _SLOW * nominal:
        return WARN, f"the odometry comes at {rate:.1f} Hz instead of {nominal:g} Hz"
    if health.awaits_rest:
        return WARN, AWAITS_REST
    if retried > _RETRIED:
        return WARN, "many packets have to be sent again: see to cable, ground and baud"
    return OK, "drives"
