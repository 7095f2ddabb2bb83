"""Component-based robot middleware over Eclipse Zenoh, with a navigation system built on it.

The names below are what components are written with: `from cairn import Component, In, Out, on`.
They are loaded when they are first used, so that `import cairn` costs almost nothing.
`docs/reference/api.md` lists every public module; all else is private.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from cairn.bus.qos import LATCHED, RELIABLE, SENSOR, Qos
    from cairn.clock import SECOND, Clock, from_ns, to_ns
    from cairn.errors import CairnError
    from cairn.runtime.component import Component
    from cairn.runtime.parameters import Config, Mount, ParameterRejected, ReadPath
    from cairn.runtime.ports import In, Out, every, on

__all__ = [
    "LATCHED",
    "RELIABLE",
    "SECOND",
    "SENSOR",
    "CairnError",
    "Clock",
    "Component",
    "Config",
    "In",
    "Mount",
    "Out",
    "ParameterRejected",
    "Qos",
    "ReadPath",
    "every",
    "from_ns",
    "on",
    "to_ns",
]

_MODULES: Final = {
    "cairn.bus.qos": ("LATCHED", "RELIABLE", "SENSOR", "Qos"),
    "cairn.clock": ("SECOND", "Clock", "from_ns", "to_ns"),
    "cairn.errors": ("CairnError",),
    "cairn.runtime.component": ("Component",),
    "cairn.runtime.parameters": ("Config", "Mount", "ParameterRejected", "ReadPath"),
    "cairn.runtime.ports": ("In", "Out", "every", "on"),
}


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
