"""Log records on topic /rosout, as every ROS 2 node publishes its own."""

import json
import logging
from datetime import UTC, datetime

from cairn.bus.bus import Node
from cairn.bus.qos import Qos
from cairn.clock import SECOND, from_ns
from cairn.schemas.rcl_interfaces import Log

ROSOUT = "/rosout"
ROSOUT_QOS = Qos("reliable", "transient_local", 1000)

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
        self._publisher = node.advertise(ROSOUT, Log, ROSOUT_QOS)

    def emit(self, record: logging.LogRecord) -> None:
        """Publish one record; `logging` calls this under the handler's lock."""
        try:
            self._publisher.publish(_entry(record))
        except Exception:  # a log statement must not fail the component
            self.handleError(record)


def _entry(record: logging.LogRecord) -> Log:
    return Log(
        stamp=from_ns(int(record.created * SECOND)),
        level=_LEVELS.get(record.levelno, 20),
        name=record.name.removeprefix("cairn."),
        msg=wire_safe_text(record.getMessage()),
        file=wire_safe_text(record.filename),
        function=record.funcName or "",
        line=record.lineno,
    )


def render(entry: Log, *, as_json: bool = False) -> str:
    """One log message as a line, or as JSON."""
    seconds = entry.stamp.sec + entry.stamp.nanosec / SECOND
    level = _NAMES.get(entry.level, str(entry.level))
    if as_json:
        return json.dumps(
            {"time": seconds, "level": level, "name": entry.name, "message": entry.msg}
        )
    clock = datetime.fromtimestamp(seconds, UTC).astimezone().strftime("%H:%M:%S.%f")[:-3]
    return f"{clock} {level:<7} {entry.name}: {entry.msg}"


def wire_safe_text(text: str) -> str:
    """Any text as a message can hold it: without NUL, and of characters that UTF-8 has."""
    return text.replace("\0", "?").encode("utf-8", "replace").decode()
