"""Component statuses as diagnostics of ROS."""

from __future__ import annotations

from cairn.driver.diagnostics import ERROR, OK, STALE, WARN
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.diagnostic_msgs import DiagnosticStatus, KeyValue

_LEVELS = {"active": OK, "inactive": WARN, "unconfigured": WARN}


def diagnostic_status(robot: str, status: ComponentStatus, *, is_silent: bool) -> DiagnosticStatus:
    """Return the state of a component, as its own status or its silence shows it."""
    counts = {
        name: sum(getattr(port, name) for port in status.ports)
        for name in ("dropped", "invalid", "refused")
    }
    values = {"plugin": status.plugin, "pid": status.pid, "restarts": status.restarts, **counts}
    level = STALE if is_silent else _LEVELS.get(status.state, ERROR)
    message = f"{status.state}: {status.reason}" if status.reason else status.state
    return DiagnosticStatus(
        level=level,
        name=f"{robot}: {status.component}",
        message="no status" if is_silent else message,
        hardware_id=robot,
        values=tuple(KeyValue(key=key, value=str(value)) for key, value in values.items()),
    )
