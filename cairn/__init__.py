"""Component-based robot middleware over Eclipse Zenoh, with a navigation system built on it.

Components are written with the names of this package:

    from cairn import Component, Config, In, Out, every, on

`__all__` lists all of them. Each name is loaded when it is first used, so `import cairn` is fast.
Message classes are public, too, in a module for each ROS 2 package (`cairn.schemas.sensor_msgs`),
with `cairn.schemas.message` and `cairn.schemas.field_types` to define new ones. So are
`cairn.client` for scripts, `cairn.testing` for tests and `cairn.driver` for drivers of devices. All
other modules are private and may change without notice.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from cairn.bus.actions import ClientGoal, ServerGoal
    from cairn.bus.bus import ServiceError
    from cairn.bus.qos import LATCHED, RELIABLE, SENSOR, Qos
    from cairn.errors import CairnError
    from cairn.processes.supervisor import StartFailed, Supervisor
    from cairn.runtime.action_ports import ActionClient, ActionServer
    from cairn.runtime.component import Component
    from cairn.runtime.handlers import cancel, every, goal, on, serve
    from cairn.runtime.lifecycle import LifecycleState
    from cairn.runtime.parameters import (
        Config,
        FromRobot,
        Mount,
        ParameterRejected,
        ReadPath,
        SensorFrame,
    )
    from cairn.runtime.rate_limited_log import RateLimitedLog
    from cairn.runtime.retried_save import RetriedSave
    from cairn.runtime.service_ports import Client, Server
    from cairn.runtime.topic_ports import In, Out
    from cairn.schemas.builtin_interfaces import from_ns, to_ns
    from cairn.system.clock import SECOND, Clock, SteadyClock, has_passed

__all__ = [
    "LATCHED",
    "RELIABLE",
    "SECOND",
    "SENSOR",
    "ActionClient",
    "ActionServer",
    "CairnError",
    "Client",
    "ClientGoal",
    "Clock",
    "Component",
    "Config",
    "FromRobot",
    "In",
    "LifecycleState",
    "Mount",
    "Out",
    "ParameterRejected",
    "Qos",
    "RateLimitedLog",
    "ReadPath",
    "RetriedSave",
    "SensorFrame",
    "Server",
    "ServerGoal",
    "ServiceError",
    "StartFailed",
    "SteadyClock",
    "Supervisor",
    "cancel",
    "every",
    "from_ns",
    "goal",
    "has_passed",
    "on",
    "serve",
    "to_ns",
]

_MODULES: Final = {
    "cairn.bus.actions": ("ClientGoal", "ServerGoal"),
    "cairn.bus.bus": ("ServiceError",),
    "cairn.bus.qos": ("LATCHED", "RELIABLE", "SENSOR", "Qos"),
    "cairn.errors": ("CairnError",),
    "cairn.processes.supervisor": ("StartFailed", "Supervisor"),
    "cairn.runtime.action_ports": ("ActionClient", "ActionServer"),
    "cairn.runtime.component": ("Component",),
    "cairn.runtime.handlers": ("cancel", "every", "goal", "on", "serve"),
    "cairn.runtime.lifecycle": ("LifecycleState",),
    "cairn.runtime.parameters": (
        "Config",
        "FromRobot",
        "Mount",
        "ParameterRejected",
        "ReadPath",
        "SensorFrame",
    ),
    "cairn.runtime.rate_limited_log": ("RateLimitedLog",),
    "cairn.runtime.retried_save": ("RetriedSave",),
    "cairn.runtime.service_ports": ("Client", "Server"),
    "cairn.runtime.topic_ports": ("In", "Out"),
    "cairn.schemas.builtin_interfaces": ("from_ns", "to_ns"),
    "cairn.system.clock": ("SECOND", "Clock", "SteadyClock", "has_passed"),
}


if not TYPE_CHECKING:  # so that type checkers report names that do not exist

    def __getattr__(name: str) -> Any:
        """Import a public name from its module on first use (PEP 562)."""
        for module, names in _MODULES.items():
            if name in names:
                value = getattr(import_module(module), name)
                globals()[name] = value
                return value
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names, for completion in a shell or notebook."""
    return sorted(__all__)
