"""Pacing of a replay: the clock that publishes recorded time, and which records are due."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import ClassVar, Literal

from pydantic import Field

from cairn import LATCHED, SECOND, Component, In, Out, from_ns, on, to_ns
from cairn.components.replay_devices.config import RecordingConfig
from cairn.schemas.rosgraph_msgs import Clock

REACHED_INTERVAL = SECOND // 4
"""How often the odometry component publishes the time that the replay has reached [ns]."""

LATE_NS = SECOND // 2
"""Records that are later than this when a component starts are skipped [ns]."""


class PacedRecords:
    """The records of one topic, by their times [ns], returned in order as time passes.

    Those before `begin` and after `end` [ns] are left out, if these are set.
    """

    def __init__(
        self, times: Sequence[int], begin: int | None = None, end: int | None = None
    ) -> None:
        self._times = times
        self._next = 0 if begin is None else bisect_left(times, begin)
        self._end = len(times) if end is None else bisect_right(times, end)
        self._started = False

    def due(self, now: int) -> tuple[range, int]:
        """Return the records that are due at `now` [ns], and how many are skipped before them.

        Records are skipped only at the first call: those that were due more than 0.5 s ago, as the
        component was started late or restarted. Later delays skip nothing.
        """
        skipped = 0
        if not self._started and now > 0:
            self._started = True
            first = self._next
            while self._next < self._end and self._times[self._next] < now - LATE_NS:
                self._next += 1
            skipped = self._next - first
        first = self._next
        while self._next < self._end and self._times[self._next] <= now:
            self._next += 1
        return range(first, self._next), skipped


_LISTEN = SECOND // 2  # for the time of a replay that runs already [ns]
_TAIL = SECOND  # after the last record, in which other components finish [ns]


class ReplayClockConfig(RecordingConfig):
    """Parameters of the replay clock."""

    rate: float = Field(1.0, gt=0, le=1000, description="Recorded seconds per second [1].")
    tick_s: float = Field(
        0.05, ge=0.001, le=1.0, description="Recorded time between two messages [s]."
    )


class ReplayClock(Component):
    """Publishes recorded time (port `time`, for topic `clock`) from the first record on, then ends.

    If it is restarted, it continues from the time that the odometry component has reached.
    """

    # A replay keeps its rate, on which its report depends.
    live_parameters = frozenset()
    clock_source: ClassVar[Literal["deployment", "system"]] = "system"
    config: ReplayClockConfig
    reached: In[Clock] = In(qos=LATCHED.with_depth(10), optional=True)
    time: Out[Clock]

    _last = 0

    def on_configure(self) -> None:
        """Read the recording's first and last time; log its notes and the scanner's mount."""
        recording = self.config.open()
        for note in recording.notes():
            self.log.warning("%s: %s", self.config.recording, note)
        if (mount := recording.mount()) is not None:
            x, y, yaw = mount.pose
            self.log.info(
                "the scanner's mount in the recording, by %s: x %.3f m, y %.3f m, theta %.4f rad",
                mount.source, x, y, yaw,
            )  # fmt: skip
        first, last = self.config.part(recording)
        self._first, self._end = first, last + _TAIL

    def on_activate(self) -> None:
        """Listen first whether the replay runs already."""
        self._last = 0
        self.schedule(self.clock.now() + _LISTEN, self._start)

    @on("reached")
    def on_reached(self, reached: Clock) -> None:
        """Store the time that a running replay has reached."""
        self._last = max(self._last, to_ns(reached.clock))

    def _start(self) -> None:
        tick = round(self.config.tick_s * SECOND)
        self._origin = self._first
        if self._last:
            # After all times that its predecessor published: time never runs backwards.
            self._origin = self._last + REACHED_INTERVAL + tick
            self.log.info("continuing a running replay at %.3f s", self._origin / SECOND)
        self._started_at = self._ticked_at = self.clock.now()
        self._tick()

    def _tick(self) -> None:
        tick = round(self.config.tick_s * SECOND)
        system_now = self.clock.now()
        # Zero unless the clock was set back: recorded time goes on from where it is.
        self._started_at -= max(0, self._ticked_at - system_now)
        self._ticked_at = system_now
        passed = round((system_now - self._started_at) * self.config.rate)
        count = (passed + tick // 2) // tick
        now = self._origin + count * tick
        self.time.publish(Clock(clock=from_ns(now)))
        if now >= self._end:
            self.finish("the recording is at its end")
            return
        due = self._started_at + round((count + 1) * tick / self.config.rate)
        self.schedule(due, self._tick)
