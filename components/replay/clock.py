"""The clock of a replay: recorded time, a given number of times as fast as real time."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from cairn import LATCHED, SECOND, Component, Config, In, Out, ParameterRejected, from_ns, on, to_ns
from cairn.components.replay.driver import RecordingConfig
from cairn.components.replay.odometry import REACHED_EVERY
from cairn.schemas.rosgraph_msgs import Clock

# How long to listen for the time of a replay that runs already [ns].
_LISTEN = SECOND // 2
# How long to go on after the last record, so that everyone can finish [ns].
_TAIL = SECOND


class ReplayClockConfig(RecordingConfig):
    """Parameters of the replay's clock."""

    rate: float = Field(1.0, gt=0, le=1000, description="Recorded seconds per second [1].")
    tick_s: float = Field(
        0.05, ge=0.001, le=1.0, description="Recorded time between two messages [s]."
    )


class ReplayClock(Component):
    """Tells recorded time (port `time`, for topic `clock`) from the first record on, then ends.

    Started anew in mid-run it goes on from the time that the odometry driver has reached.
    """

    clock_source: ClassVar[Literal["deployment", "system"]] = "system"
    config: ReplayClockConfig
    reached: In[Clock] = In(qos=LATCHED.with_depth(10), optional=True)
    time: Out[Clock]

    _last = 0

    def on_configure(self) -> None:
        """Read the recording's first and last time; say how the recording falls short."""
        recording = self.config.open()
        for note in recording.notes():
            self.log.warning("%s: %s", self.config.recording, note)
        first, last = self.config.part(recording)
        self._first, self._end = first, last + _TAIL

    def on_activate(self) -> None:
        """Listen first, whether the replay runs already."""
        self._last = 0
        self.schedule(self.clock.now() + _LISTEN, self._begin)

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """A replay keeps its rate, so that its report means something."""
        raise ParameterRejected("the clock of a replay takes its parameters when it is configured")

    @on("reached")
    def note(self, reached: Clock) -> None:
        """Remember how far a running replay has come."""
        self._last = max(self._last, to_ns(reached.clock))

    def _begin(self) -> None:
        tick = round(self.config.tick_s * SECOND)
        self._origin = self._first
        if self._last:
            # Past what was told before the end of its forerunner: time never runs backwards.
            self._origin = self._last + REACHED_EVERY + tick
            self.log.info("the replay runs already: going on at %.3f s", self._origin / SECOND)
        self._began = self.clock.now()
        self._tick()

    def _tick(self) -> None:
        tick = round(self.config.tick_s * SECOND)
        passed = round((self.clock.now() - self._began) * self.config.rate)
        count = (passed + tick // 2) // tick
        now = self._origin + count * tick
        self.time.publish(Clock(clock=from_ns(now)))
        if now >= self._end:
            self.finish("the recording is at its end")
            return
        due = self._began + round((count + 1) * tick / self.config.rate)
        self.schedule(due, self._tick)
