"""What a re-run has shown: calls, messages compared, differences."""

from dataclasses import dataclass, field

from cairn.system.clock import SECOND


@dataclass(frozen=True)
class Difference:
    """Something in which the re-run differs: on which topic, when, and what both have.

    `time_ns` is when the message was sent, or that of the call, `call_ns`.
    """

    topic: str
    time_ns: int
    call_ns: int
    call: str
    what: str

    def __str__(self) -> str:
        where = f"{self.topic}: " if self.topic else ""
        return f"{where}{self.what}; at {self.time_ns / SECOND:.6f} s, in {self.call}"


@dataclass
class TopicResult:
    """The messages of one output: compared, and of them different; recorded or re-run alone."""

    compared: int = 0
    different: int = 0
    missing: int = 0
    extra: int = 0
    not_recorded: int = 0

    @property
    def differing(self) -> int:
        """How many messages differ, are missing or are extra."""
        return self.different + self.missing + self.extra


@dataclass
class RerunResult:
    """What the re-run of one start of a component has shown.

    `incomplete` says from where on, and why, the calls could not be made again, "" if all were.
    """

    component: str
    incarnation: int
    calls: int = 0
    topics: dict[str, TopicResult] = field(default_factory=dict)
    first: Difference | None = None
    differences: int = 0
    incomplete: str = ""
    notes: list[str] = field(default_factory=list)

    @property
    def equal(self) -> bool:
        """Whether all calls could be made again and all publications are equal."""
        return self.first is None and not self.incomplete
