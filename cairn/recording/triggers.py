"""Triggers of a recording: conditions on a field of a topic, and the failure of a component."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from cairn.bus.codec import Codec
from cairn.errors import CairnError
from cairn.recording.tap import Sample
from cairn.recording.topics import TopicPatterns
from cairn.runtime.rosout import ROSOUT
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.message import InvalidMessage, type_name
from cairn.schemas.rcl_interfaces import Log

_STATUS_TOPIC: Final = "/*/component_status"
_FAILURES: Final = ("child failed: ", "child hung: ", "child start failed: ")
"""Log messages with which supervisors report that a component has failed."""
_CONDITION = re.compile(
    r"\s*(?P<topic>/?[A-Za-z0-9_*/]+)\.(?P<fields>[A-Za-z0-9_.]+)\s*"
    r"(?P<sign><=|>=|==|!=|<|>)\s*(?P<value>\S+)\s*"
)
_SIGNS: Mapping[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
_LONGEST_REASON: Final = 200  # characters
_WORDS = {"true": 1.0, "false": 0.0}


class Condition:
    """A condition on a number in the messages of a topic: `localization.health < 0.3`.

    It triggers when a message meets it and the message before, of the same publisher, did not.
    """

    def __init__(self, text: str, robot: str = "") -> None:
        """Parse a condition; raises `CairnError` if it is malformed."""
        parsed = _CONDITION.fullmatch(text)
        value = _number(parsed["value"]) if parsed is not None else None
        if parsed is None or value is None:
            raise CairnError(
                f"trigger {text!r}: write it as TOPIC.FIELD < NUMBER (or <=, >, >=, ==, !=), such "
                "as `localization.health < 0.3`"
            )
        self.text = text.strip()
        self.patterns = TopicPatterns([parsed["topic"]], robot)
        self._fields = parsed["fields"].split(".")
        self._sign = _SIGNS[parsed["sign"]]
        self._value = value
        self._met: dict[bytes, bool] = {}
        self.works = False
        """Whether a message had that number."""
        self.problem = ""
        """Why the last message without that number had none."""

    def observe(self, gid: bytes, message: Any) -> str | None:
        """Return why a message triggers; None if it does not, or has no such number."""
        try:
            value = self._value_in(message)
        except CairnError as error:
            self.problem = str(error)
            return None
        self.works = True
        met = self._sign(value, self._value)
        before = self._met.get(gid, False)
        if len(self._met) >= 1000:
            self._met.clear()
        self._met[gid] = met
        return f"{self.text} (it is {value:g})" if met and not before else None

    def _value_in(self, message: Any) -> float:
        value = message
        for name in self._fields:
            if name.startswith("_") or not hasattr(type(value), "__dataclass_fields__"):
                raise self._no_number(message)
            if name not in type(value).__dataclass_fields__:
                raise self._no_number(message)
            value = getattr(value, name)
        if not isinstance(value, int | float):
            raise self._no_number(message)
        return float(value)

    def _no_number(self, message: Any) -> CairnError:
        name = type_name(type(message))
        return CairnError(
            f"trigger {self.text!r}: {name} has no number {'.'.join(self._fields)}; `cairn schema "
            f"show {name}` lists its fields"
        )


class Triggers:
    """The triggers of a recorder."""

    def __init__(
        self,
        conditions: Sequence[str],
        robot: str,
        find_message: Callable[[str], type[Any] | None],
        *,
        on_failure: bool,
        since_ns: int,
    ) -> None:
        """Parse the conditions; raises `CairnError` if one is malformed.

        Failures that were logged before `since_ns` [ns] do not trigger.
        """
        self._since_ns = since_ns
        self._conditions = [Condition(text, robot) for text in conditions]
        self._find_message = find_message
        status = [_STATUS_TOPIC.replace("*", robot or "*")] if on_failure else []
        if on_failure:
            status.append(ROSOUT)
        self._robot = robot
        self._statuses = TopicPatterns(status)
        self._restarts: dict[str, int] = {}  # by component
        self._codec = Codec()
        self.topics = tuple(
            dict.fromkeys(
                [*status, *(one for item in self._conditions for one in item.patterns.patterns)]
            )
        )

    @property
    def problem(self) -> str:
        """Why a condition could not be evaluated; "" if all could so far."""
        return next((one.problem for one in self._conditions if one.problem), "")

    @property
    def cannot_work(self) -> bool:
        """Whether nothing can trigger: no message that came had the number of any condition."""
        broken = [one.problem and not one.works for one in self._conditions]
        return bool(broken) and all(broken) and not self._statuses.patterns

    def clock_set_back(self, now_ns: int) -> None:
        """Take failures that are logged from `now_ns` [ns] on: the clock was set back to it."""
        self._since_ns = min(self._since_ns, now_ns)

    def needs(self, topic: str) -> bool:
        """Return whether messages on a topic (full name) can trigger."""
        return self._statuses.match(topic) or any(
            condition.patterns.match(topic) for condition in self._conditions
        )

    def observe(self, sample: Sample) -> str | None:
        """Return why a message triggers; None if it does not."""
        if not self.topics or not self.needs(sample.topic):
            return None
        message_class = self._find_message(sample.type_name)
        if message_class is None:
            unknown = f"{sample.topic}: message type {sample.type_name} is not known"
            for condition in self._conditions:
                if condition.patterns.match(sample.topic):
                    condition.problem = unknown
            return None
        try:
            message = self._codec.decode(message_class, sample.payload)
        except InvalidMessage:
            return None  # a foreign publisher's; components count it
        reasons = []
        if self._statuses.match(sample.topic):
            if isinstance(message, ComponentStatus):
                reasons.append(self._restart(sample.topic.split("/")[1], message))
            elif isinstance(message, Log) and sample.sent_ns >= self._since_ns:
                reasons.append(self._failure(message))
        reasons += [
            condition.observe(sample.gid, message)
            for condition in self._conditions
            if condition.patterns.match(sample.topic)
        ]
        return "; ".join(filter(None, reasons)) or None

    def _failure(self, entry: Log) -> str | None:
        """Return the log message of a supervisor that reports a failure; None for any other."""
        of_robot = entry.name.partition(".")[0]
        if entry.msg.startswith(_FAILURES) and self._robot in ("", of_robot):
            return f"{entry.name}: {entry.msg[:_LONGEST_REASON]}"
        return None

    def _restart(self, robot: str, status: ComponentStatus) -> str | None:
        """Return why the status of a component means that it was restarted since its last one."""
        name = f"/{robot}/{status.component}"
        before = self._restarts.get(name)
        if len(self._restarts) >= 1000:
            self._restarts.clear()
        self._restarts[name] = status.restarts
        if before is not None and status.restarts > before:
            return f"{name} was restarted: {status.reason}"
        return None


def _number(text: str) -> float | None:
    try:
        value = _WORDS[text] if text in _WORDS else float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
