"""What a driver tells of its device on topic `diagnostics`, as ROS 2's tools read it."""

from __future__ import annotations

from collections.abc import Mapping

from cairn.clock import from_ns
from cairn.schemas.diagnostic_msgs import DiagnosticArray, DiagnosticStatus, KeyValue
from cairn.schemas.std_msgs import Header

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)


def diagnostics(
    now: int,
    name: str,
    hardware_id: str,
    level: int,
    message: str,
    values: Mapping[str, object],
) -> DiagnosticArray:
    """The message that tells how one device is.

    `now`: time of the component's clock [ns]; `name`: the component's; `hardware_id`: what tells
    this device from others of its kind, such as its serial number; `values`: what is known of it,
    told as text.
    """
    told = tuple(KeyValue(key=key, value=_text(value)) for key, value in values.items())
    status = DiagnosticStatus(
        level=level, name=name, message=message, hardware_id=hardware_id, values=told
    )
    return DiagnosticArray(header=Header(stamp=from_ns(now)), status=(status,))


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
