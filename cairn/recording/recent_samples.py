"""What a recorder keeps in memory: the messages of the last seconds, and those that are latched."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Final

from cairn.recording.tap import Sample
from cairn.system.clock import SECOND

_SET_BACK_NS: Final = SECOND
"""An older sample may have waited for its publisher; if it is older still, the clock was set."""

_SAMPLE_BYTES: Final = 600  # memory of a sample, besides its payload
_LATCHED_BYTES: Final = 64 << 20


def memory_of(sample: Sample) -> int:
    """Return the memory that a sample takes [bytes]."""
    return len(sample.payload) + _SAMPLE_BYTES


class SampleRing:
    """The samples of the last seconds, oldest first, within a limit of memory."""

    def __init__(self, last_s: float, limit: int) -> None:
        """Keep `last_s` seconds, or less in `limit` bytes."""
        self._last_ns = round(last_s * SECOND)
        self._limit = limit
        self._samples: deque[tuple[int, Sample]] = deque()  # with _passed_ns at the time
        self._passed_ns = 0  # it stands still when the clock is set back
        self._newest_ns = 0
        self._bytes = 0

    def __iter__(self) -> Iterator[Sample]:
        return (sample for _, sample in self._samples)

    def add(self, sample: Sample) -> list[Sample]:
        """Add a sample; return those that it displaces."""
        passed = sample.received_ns - self._newest_ns
        if passed > 0 or passed < -_SET_BACK_NS:
            self._passed_ns += max(0, passed) if self._newest_ns else 0
            self._newest_ns = sample.received_ns
        self._samples.append((self._passed_ns, sample))
        self._bytes += memory_of(sample)
        oldest = self._passed_ns - self._last_ns
        displaced = []
        while self._samples and (self._samples[0][0] < oldest or self._bytes > self._limit):
            _, old = self._samples.popleft()
            self._bytes -= memory_of(old)
            displaced.append(old)
        return displaced


class LatchedSamples:
    """The last messages of latched topics, of each publisher as many as it keeps itself."""

    def __init__(self) -> None:
        self._samples: dict[tuple[str, bytes], deque[Sample]] = {}
        self._bytes = 0

    def add(self, sample: Sample, depth: int) -> None:
        """Add a message of a publisher that keeps `depth`."""
        kept = self._samples.setdefault((sample.topic, sample.gid), deque())
        kept.append(sample)
        self._bytes += memory_of(sample)
        while len(kept) > depth:
            self._discard(kept)
        while self._bytes > _LATCHED_BYTES and self._samples:
            first = next(iter(self._samples))
            oldest = self._samples[first]
            self._discard(oldest)
            if not oldest:
                del self._samples[first]

    def messages(self, since_ns: int = 0) -> list[Sample]:
        """Return the messages that were received since then, in that order."""
        kept = [one for some in self._samples.values() for one in some]
        return sorted(
            (one for one in kept if one.received_ns >= since_ns), key=lambda one: one.received_ns
        )

    def _discard(self, kept: deque[Sample]) -> None:
        self._bytes -= memory_of(kept.popleft())
