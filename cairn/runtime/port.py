"""What all ports have in common."""

from typing import Any, Self

from cairn.bus.message_limits import LONGEST_MAX_BYTES
from cairn.errors import CairnError
from cairn.runtime.call_log import CallLog
from cairn.runtime.call_records import RecordKind
from cairn.runtime.component import ComponentContext
from cairn.schemas.cairn_msgs import PortStatus
from cairn.schemas.message import type_name


class Port:
    """A port: declared in the body of a component's class, bound for each of its instances.

    A declaration has what its author chose. The runtime copies it, adds its name and type, which
    the annotation says, and binds it to its name on the bus: then it sends, receives and counts.
    """

    name = ""
    """Name of the component's attribute."""
    interface: type[Any] = object
    """Class of its messages, or of its service or action."""
    _full_name = ""
    _context: ComponentContext
    _call_log: CallLog | None

    def declare(self, name: str, interface: type[Any]) -> Self:
        """Set the name, and the class of the messages, of the service or of the action."""
        self.name = name
        self.interface = interface
        return self

    def _bind(self, context: ComponentContext, full_name: str) -> None:
        self._context = context
        self._call_log = context.call_log
        self._full_name = full_name

    def _bound_name(self) -> str:
        """Return the full name on the bus; `CairnError` on a declaration."""
        if not self._full_name:
            raise CairnError(
                f"this {type(self).__name__} port is a declaration; only the ports of a component "
                "that a deployment, an executor or a test has started can be used"
            )
        return self._full_name

    def _log_presence(self, present: bool) -> None:
        """Log that the component has asked whether anything is at the other end."""
        if self._call_log is not None:
            kind = RecordKind.HAS_SUBSCRIBERS if present else RecordKind.NO_SUBSCRIBERS
            self._call_log.add(kind, self.name)

    def _status(self, direction: int, messages: int, **others: int) -> PortStatus:
        """Return a status with these counters."""
        return PortStatus(
            port=self.name,
            topic=self._full_name,
            direction=direction,
            messages=messages,
            **others,
        )


def check_max_bytes(kind: str, max_bytes: int | None) -> None:
    """Raise `CairnError` for a limit [bytes] that cannot be set."""
    if max_bytes is not None and not 1 <= max_bytes <= LONGEST_MAX_BYTES:
        raise CairnError(
            f"{kind}(max_bytes={max_bytes}): a limit is from 1 to {LONGEST_MAX_BYTES:,} bytes"
        )


def type_of(message: Any) -> str:
    """Return the name of a message's type, or the class of another object."""
    try:
        return type_name(type(message))
    except TypeError:
        return f"{type(message).__module__}.{type(message).__qualname__}"
