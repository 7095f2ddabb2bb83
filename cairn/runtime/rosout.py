"""Log records on topic /rosout, where every ROS 2 node publishes its log."""

import json
import logging
from datetime import UTC, datetime

from cairn.bus.bus import Node
from cairn.bus.qos import Qos
from cairn.schemas.builtin_interfaces import from_ns
from cairn.schemas.rcl_interfaces import Log
from cairn.system.clock import SECOND

ROSOUT = "/rosout"
ROSOUT_QOS = Qos("reliable", "transient_local", 1000)
"""As ROS 2 defines it: the last 1000 records of each node are latched."""

_LEVELS = {
    logging.DEBUG: 10,
    logging.INFO: 20,
    logging.WARNING: 30,
    logging.ERROR: 40,
    logging.CRITICAL: 50,
}
_NAMES = {level: logging.getLevelName(python) for python, level in _LEVELS.items()}


class RosoutHandler(logging.Handler):
    """Publishes the records of one component's logger."""

    def __init__(self, node: Node) -> None:
        super().__init__()
        self._publisher = node.advertise(ROSOUT, Log, ROSOUT_QOS, shared=True)

    def emit(self, record: logging.LogRecord) -> None:
        """Publish one record; `logging` calls this with the handler's lock held."""
        try:
            self._publisher.publish(_log_message(record))
        except Exception:  # a log statement must not fail the component
            self.handleError(record)


def render(entry: Log, *, as_json: bool = False) -> str:
    """Return one log message as a line of text, or as JSON."""
    seconds = entry.stamp.sec + entry.stamp.nanosec / SECOND
    level = _NAMES.get(entry.level, str(entry.level))
    if as_json:
        return json.dumps(
            {"time": seconds, "level": level, "name": entry.name, "message": entry.msg}
        )
    clock = datetime.fromtimestamp(seconds, UTC).astimezone().strftime("%H:%M:%S.%f")[:-3]
    return f"{clock} {level:<7} {entry.name}: {entry.msg}"


def wire_safe_text(text: str) -> str:
    """Return a text as a message can hold it: without NUL and without lone surrogates."""
    return text.replace("\0", "?").encode("utf-8", "replace").decode()


def _log_message(record: logging.LogRecord) -> Log:
    return Log(
        stamp=from_ns(int(record.created * SECOND)),
        level=_LEVELS.get(record.levelno, 20),
        name=record.name.removeprefix("cairn."),
        msg=wire_safe_text(record.getMessage()),
        file=wire_safe_text(record.filename),
        function=record.funcName or "",
        line=record.lineno,
    )
