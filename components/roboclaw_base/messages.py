"""Messages of the base: odometry, battery, diagnostics."""

from __future__ import annotations

import numpy as np

from cairn import from_ns
from cairn.components.roboclaw_base.health import ControllerHealth
from cairn.components.roboclaw_base.odometry import OdometryNoise, WheelOdometry, WheelStep
from cairn.driver.diagnostics import ERROR, OK, WARN, diagnostics
from cairn.planar.messages import transform_message, twist_message, with_covariance
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.geometry_msgs import TransformStamped, TwistWithCovariance
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.sensor_msgs import BatteryState
from cairn.schemas.std_msgs import Header

_ODOM, _BASE = "odom", "base_link"  # frames
_FORWARD, _TURN = 0, 35  # indices of their variances in a row-major 6 x 6 matrix
_SLOW = 0.8  # share of the nominal rate below which diagnostics warn
_RETRIED = 0.02  # share of packets sent again above which diagnostics warn

AWAITS_REST = (
    "the motors were off: the base stands until the command has been rest, or has ceased, once"
)


def odometry_message(
    odometry: WheelOdometry, step: WheelStep, speed: tuple[float, float], noise: OdometryNoise
) -> Odometry:
    """Return the pose at the end of a step, and the speed [m/s, rad/s]."""
    seconds = step.seconds or 1.0
    covariance = np.zeros(36)
    # The random walks of a step, as speeds.
    covariance[_FORWARD] = noise.distance**2 * abs(step.distance) / seconds**2
    covariance[_TURN] = (
        noise.turn**2 * abs(step.turn) + noise.turn_per_meter**2 * abs(step.distance)
    ) / seconds**2
    return Odometry(
        header=Header(stamp=from_ns(step.stamp), frame_id=_ODOM),
        child_frame_id=_BASE,
        pose=with_covariance(odometry.pose, odometry.covariance),
        twist=TwistWithCovariance(twist=twist_message(*speed), covariance=covariance),
    )


def odometry_transform(message: Odometry, odometry: WheelOdometry) -> TransformStamped:
    """Return the same pose as a transform."""
    return transform_message(message.header, _BASE, odometry.pose)


def battery_message(stamp: int, health: ControllerHealth) -> BatteryState:
    """Return voltage and current of the main battery; both motors discharge it."""
    return BatteryState(
        header=Header(stamp=from_ns(stamp), frame_id=_BASE),
        voltage=health.voltage,
        current=-sum(abs(current) for current in health.currents),
        present=True,
    )


def diagnostics_message(
    now: int,
    name: str,
    port: str,
    health: ControllerHealth,
    retry_share: float,
    rate: float,
    nominal: float,
) -> DiagnosticArray:
    """Return the state of the controller.

    `retry_share`: of the packets sent recently [1]; `rate`: of the odometry [Hz], against the
    nominal one.
    """
    level, message = _judge(health, retry_share, rate, nominal)
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
        "wheel fault": health.wheel_fault or "none",
        "connections": health.connections,
        "packets": counts.packets,
        "packets sent again": counts.retries,
        "replies missing": counts.missing,
        "replies damaged": counts.damaged,
    }
    return diagnostics(now, name, health.version, level, message, values)


def _judge(
    health: ControllerHealth, retry_share: float, rate: float, nominal: float
) -> tuple[int, str]:
    if health.device_error is not None:
        return ERROR, health.device_error
    if health.wheel_fault is not None:
        return ERROR, f"{health.wheel_fault}; the motors are off until the driver is restarted"
    if health.status.errors:
        return ERROR, f"the RoboClaw does not drive: {', '.join(health.status.errors)}"
    if health.status.warnings:
        return WARN, f"the RoboClaw warns: {', '.join(health.status.warnings)}"
    if rate < _SLOW * nominal:
        return WARN, f"the odometry comes at {rate:.1f} Hz instead of {nominal:g} Hz"
    if health.awaits_rest:
        return WARN, AWAITS_REST
    if retry_share > _RETRIED:
        return WARN, (
            f"{retry_share:.0%} of the packets had to be sent again; check cable, ground and baud"
        )
    return OK, "drives"
