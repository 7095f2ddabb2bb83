"""The recorder: takes the samples of a tap, and decides what is written to which file, and when.

`cairn record`, the component `recorder` and `cairn up --record` use it. Samples wait in a queue of
limited size, from which one thread writes them: a slow or full disk holds up nothing but that
thread, and what the queue does not hold is counted as dropped.
"""

from __future__ import annotations

import errno
import logging
import re
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from cairn.bus.keys import own_name
from cairn.deployment.model import ALL_TOPICS
from cairn.errors import CairnError
from cairn.recording.recent_samples import LatchedSamples, SampleRing, memory_of
from cairn.recording.tap import PublisherInfo, Sample, Tap
from cairn.recording.topics import TopicPatterns
from cairn.recording.triggers import Triggers
from cairn.recording.writer import Compression, FindMessage, RecordingFile
from cairn.runtime.parameters import Config
from cairn.system.bell import Bell
from cairn.system.clock import SECOND, has_passed
from cairn.system.files import explain_os_error, explained

_log = logging.getLogger("cairn.recording")

_PERIOD_S = 0.5
"""Interval in which chunks are closed, so that a killed recorder has lost less than a second."""
_CHUNK_BYTES = 2 << 20  # waiting, at which a chunk is written earlier
_UNKNOWN_S = 3.0
"""A message of a publisher that the graph does not have yet waits for it so long [s]: a client
reads the graph once a second, more seldom if that takes long."""
_RETRY_S = 1.0  # after a failure of the disk
_LOSSES_S = 5.0  # interval for noting losses in the file
_LARGE_BYTES = 64 << 10  # messages for which only half of the queue is free
_MIB = 1 << 20
_MOST_FILES = 100_000
_MOST_TOPICS = 100_000
_REQUEST_S = 1.0
_JOIN_S = 3.0  # less than a component has for stopping

Pattern = Annotated[str, Field(pattern=r"^/?[A-Za-z0-9_*]+(/[A-Za-z0-9_*]+)*$")]


class RecorderSettings(Config):
    """What a recorder records, and how."""

    topics: tuple[Pattern, ...] = Field(
        (ALL_TOPICS,),
        min_length=1,
        max_length=100,
        description="Topics to record; * stands for any characters in a name, ** for any levels.",
    )
    exclude: tuple[Pattern, ...] = Field(
        (), max_length=100, description="Topics not to record, as patterns."
    )
    compression: Compression = Field(
        "lz4",
        description="Compression of the file's chunks: lz4; zstd, which makes the files smaller by "
        "a quarter and needs ten times the processor time; none.",
    )
    split_mb: int = Field(
        4096,
        ge=1,
        le=1 << 20,
        description="A longer file is closed, and a new one is started [MiB].",
    )
    split_s: float = Field(
        3600.0, ge=1, le=86400, description="A file of a longer duration is closed likewise [s]."
    )
    disk_limit_mb: int = Field(
        0,
        ge=0,
        le=1 << 30,
        description="Size of all files together; beyond it the oldest is removed; 0: no limit "
        "[MiB].",
    )
    keep_free_mb: int = Field(
        500,
        ge=0,
        le=1 << 30,
        description="Space left free on the disk; the recording continues when there is more "
        "[MiB].",
    )
    queue_mb: int = Field(
        64,
        ge=4,
        le=4096,
        description="Memory for messages that wait for the disk; others are dropped and counted "
        "[MiB].",
    )
    last_s: float = Field(
        0.0,
        ge=0,
        le=3600,
        description="Keep only so much in memory, and write it when triggered; 0: write all [s].",
    )
    after_s: float = Field(
        5.0, ge=0, le=3600, description="Time recorded after a trigger, with `last_s` [s]."
    )
    buffer_mb: int = Field(
        256,
        ge=4,
        le=1 << 16,
        description="Memory for `last_s`; if it is used up, less time is kept [MiB].",
    )
    triggers: tuple[str, ...] = Field(
        (),
        max_length=20,
        description="Conditions that trigger, with `last_s`: `localization.health < 0.3`.",
    )
    trigger_on_failure: bool = Field(
        False, description="Trigger when any component fails, with `last_s`."
    )


_Request = Callable[[], None]
"""What was asked of the recorder; it comes after the samples before it."""


@dataclass(frozen=True)
class RecorderStatus:
    """What a recorder has done so far.

    Attributes:
        files: paths of the files that exist, oldest first; the last one may be under way.
        size: of these files [bytes].
        messages: number of messages written, with those that the disk has not taken yet.
        dropped: number of messages that the recorder had no memory for, by topic.
        lost: number of messages that did not reach the recorder, by topic.
        refused: number of samples that cannot be recorded.
        paused: whether it is paused.
        problem: why the disk takes nothing at present, or a trigger cannot work; "" if all is well.
    """

    files: tuple[Path, ...]
    size: int
    messages: int
    dropped: Mapping[str, int]
    lost: Mapping[str, int]
    refused: int
    paused: bool
    problem: str

    def as_plain(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return {
            "text": self.text(),
            "files": [str(path) for path in self.files],
            "bytes": self.size,
            "messages": self.messages,
            "dropped": dict(self.dropped),
            "lost": dict(self.lost),
            "refused": self.refused,
            "paused": self.paused,
            "problem": self.problem,
        }

    def text(self) -> str:
        """Return it in one line."""
        state = "paused" if self.paused else "recording"
        parts = [f"{state}: {self.messages} messages, {self.size / 1e6:.1f} MB"]
        for name, counts in (("dropped", self.dropped), ("lost", self.lost)):
            if counts:
                parts.append(f"{sum(counts.values())} {name}")
        if self.refused:
            parts.append(f"{self.refused} refused")
        return "; ".join([", ".join(parts), *filter(None, [self.problem])])


class McapRecorder:
    """Records the samples that `receive` is called with; the other methods are for one thread."""

    def __init__(
        self,
        settings: RecorderSettings,
        path: Path,
        attachments: Mapping[str, bytes],
        find_message: FindMessage,
        *,
        robot: str = "",
        now: Callable[[], int] = time.time_ns,
        threaded: bool = True,
        adopt_files: bool = False,
        log: logging.Logger = _log,
    ) -> None:
        """Prepare a recording in the file `path`; further files are `NAME_2.mcap`, `NAME_3.mcap`.

        Args:
            settings: what to record, and how.
            path: of the first file; if it exists, the next free name is used.
            attachments: files to attach to each file, by name.
            find_message: finds the definitions of message types.
            robot: to whose topics names without / belong; "": to those of every robot.
            now: time [ns].
            threaded: whether a thread writes (`start`); otherwise `receive` does, in lockstep.
            adopt_files: whether files of an earlier run count for the disk limit, too.
            log: where to report triggers and failures of the disk.

        Raises `CairnError` if a trigger is invalid.
        """
        self.settings = settings
        self._path = path
        self._attachments = attachments
        self._find_message = find_message
        self._now = now
        self._threaded = threaded
        self._log = log
        self._include = TopicPatterns(settings.topics, robot)
        self._exclude = TopicPatterns(settings.exclude, robot)
        self._triggers = Triggers(
            settings.triggers,
            robot,
            find_message,
            on_failure=settings.trigger_on_failure,
            since_ns=now(),
        )
        self.failure: Exception | None = None
        """Why nothing is written any more; None if it is."""
        self._tap: Tap | None = None
        self._bell = Bell()
        self._lock = threading.Lock()
        self._queue: list[Sample | _Request] = []
        self._queued = 0  # bytes, with those that are being written
        self._dropped: Counter[str] = Counter()
        self._refused = 0
        self._wanted: dict[str, bool] = {}
        self._file: RecordingFile | None = None
        self._files: dict[Path, int] = self._existing() if adopt_files else {}
        self._next_number = 1
        self._messages = 0
        self._problem = ""
        self._disk_failed_at = 0
        self._stepped_at = 0
        self._noted: tuple[int, int] = (0, 0)
        self._noted_at = 0
        self._latched = LatchedSamples()
        self._carried: dict[bytes, list[Sample]] = {}
        self._ring = SampleRing(settings.last_s, settings.buffer_mb * _MIB)
        self._triggered_at = 0
        self._paused = False
        self._paused_at = 0
        self._thread: threading.Thread | None = None
        self._ending = False

    @property
    def topics(self) -> tuple[str, ...]:
        """The patterns (full names) of what its tap has to deliver."""
        return (*self._include.patterns, *self._triggers.topics)

    @property
    def continuous(self) -> bool:
        """Whether it writes everything, without a trigger."""
        return self.settings.last_s == 0

    @property
    def cannot_trigger(self) -> bool:
        """Whether it waits for triggers of which none can work; the status says why."""
        return not self.continuous and self._triggers.cannot_work

    def start(self, tap: Tap) -> None:
        """Start to record what a tap delivers to `receive`.

        Raises `CairnError` if the file cannot be created.
        """
        self._tap = tap
        folder = self._path.parent
        if not folder.is_dir():
            raise CairnError(f"{folder}: no such folder for the recording; create it")
        if self.continuous:
            with explained(f"{self._path}: the recording cannot be created"):
                self._open("").save()  # also an early end leaves a file that can be read
        if self._threaded:
            self._thread = threading.Thread(target=self._run, name="cairn recorder", daemon=True)
            self._thread.start()

    def receive(self, sample: Sample) -> None:
        """Record a sample; from any thread. It waits for nothing."""
        wanted = self._wanted.get(sample.topic)
        if wanted is None:
            wanted = self._is_wanted(sample.topic)
        if not wanted:
            return
        size = memory_of(sample)
        limit = self.settings.queue_mb * _MIB
        if size >= _LARGE_BYTES:
            limit //= 2  # so that images do not displace everything else
        with self._lock:
            if self._queued and self._queued + size > limit:
                self._dropped[sample.topic] += 1
                return
            self._queue.append(sample)
            self._queued += size
            is_much = self._queued > _CHUNK_BYTES
        if not self._threaded:
            is_due = is_much or has_passed(_PERIOD_S, self._stepped_at, sample.received_ns)
            if is_due and self._tap is not None:
                self._step_within_call()
        elif is_much:
            self._bell.ring()

    def trigger(self, reason: str) -> None:
        """Write what the last seconds brought; raises `CairnError` if it records all anyway."""
        if self.continuous:
            raise CairnError(
                "a trigger needs a recorder that keeps the last seconds: set last_s (--last)"
            )
        self._request(lambda: self._on_trigger(reason))

    def split(self) -> None:
        """Close the file and begin a new one."""
        self._request(self._split)

    def pause(self) -> None:
        """Record nothing until `resume`."""
        self._request(self._on_pause)

    def resume(self) -> None:
        """Record again."""
        self._request(self._on_resume)

    def status(self) -> RecorderStatus:
        """Return what it has done so far; from any thread."""
        file, tap = self._file, self._tap
        files = dict(self._files)
        if file is not None:
            files[file.path] = file.size
        return RecorderStatus(
            files=tuple(files),
            size=sum(files.values()),
            messages=self._messages + (file.messages if file is not None else 0),
            dropped=dict(self._dropped),
            lost={} if tap is None else self._lost(tap),
            refused=self._refused + (0 if tap is None else tap.refused),
            paused=self._paused,
            problem=self._problem or self._triggers.problem,
        )

    def close(self) -> RecorderStatus:
        """Write what waits, close the file, and return what was done."""
        if self._thread is not None:
            self._ending = True
            self._bell.ring()
            self._thread.join(_JOIN_S)
            if self._thread.is_alive():
                self._problem = f"the disk took nothing for {_JOIN_S:g} s"
                return self.status()
        if self._tap is not None and self.failure is None:
            self._step(ending=True)
        self._close_file()
        return self.status()

    def _run(self) -> None:
        try:
            while not self._ending:
                self._bell.wait(_PERIOD_S)
                self._step()
        except Exception as error:
            self._fail(error)

    def _step_within_call(self) -> None:
        """Write what waits, in the call of a component, which no failure of this one may fail."""
        if self.failure is None:
            try:
                self._step()
            except Exception as error:
                self._fail(error)

    def _fail(self, error: Exception) -> None:
        self.failure = error
        self._log.error("recording failed: %s", error, exc_info=error)

    def _step(self, *, ending: bool = False) -> None:
        """Write what waits, and close the chunk."""
        now = self._now()
        self._triggers.clock_set_back(now)
        if (set_back := self._stepped_at - now) > 0:
            self._triggered_at = min(now, self._triggered_at - set_back)
            self._paused_at = min(now, self._paused_at - set_back)
        self._stepped_at = now
        if self._problem and not ending:
            is_due = has_passed(_RETRY_S, self._disk_failed_at, now)
            if not is_due or not self._recovered():
                return
        with self._lock:
            batch, self._queue = self._queue, []
        ready = deque(self._known(batch, self._now(), ending=ending))
        try:
            while ready:
                one = ready[0]
                if isinstance(one, Sample):
                    self._take(one)
                else:
                    one()
                ready.popleft()
            self._save()
            if self._file is not None:
                self._limit_file(self._now())
        except OSError as error:
            self._dropped.update(one.topic for one in ready if isinstance(one, Sample))
            self._report_disk(error)
        finally:
            size = sum(memory_of(one) for one in batch if isinstance(one, Sample))
            with self._lock:
                self._queued -= size

    def _known(
        self, batch: list[Sample | _Request], now: int, *, ending: bool
    ) -> list[Sample | _Request]:
        """Return the samples of known publishers, and those that have waited long enough.

        Requests stay where they are among them.
        """
        tap = self._tap
        assert tap is not None
        ready: list[Sample | _Request] = []
        for gid in tuple(self._carried):
            waiting = self._carried[gid]
            late = has_passed(_UNKNOWN_S, waiting[0].received_ns, now)
            if ending or late or tap.publisher(gid) is not None:
                ready += self._carried.pop(gid)
        for sample in batch:
            if not isinstance(sample, Sample):
                ready.append(sample)
                continue
            gid = sample.gid
            if gid in self._carried:
                self._carried[gid].append(sample)
            elif (
                ending
                or tap.publisher(gid) is not None
                or has_passed(_UNKNOWN_S, sample.received_ns, now)
                or (self._file is not None and self._file.has_channel(sample))
            ):
                ready.append(sample)
            else:
                self._carried[gid] = [sample]
        return ready

    def _take(self, sample: Sample) -> None:
        reason = self._triggers.observe(sample)
        if not self._is_recorded(sample.topic) or self._is_repeated(sample):
            pass
        elif self.continuous:
            if not self._paused:
                self._write(sample, sample.received_ns)
            self._keep_latched(sample)
        else:
            if self._file is not None and not self._paused:
                self._write(sample, sample.received_ns)
            for old in self._ring.add(sample):
                self._keep_latched(old)
        if reason and not self.continuous and not self._paused:
            self._on_trigger(reason)

    def _write(self, sample: Sample, log_ns: int) -> None:
        if self._file is None:  # the disk did not take a new one
            self._open("")
        assert self._file is not None
        if not self._file.add(sample, self._info(sample.gid), log_ns):
            self._refused += 1

    def _keep_latched(self, sample: Sample) -> None:
        info = self._info(sample.gid)
        if info is not None and info.qos.latched:
            self._latched.add(sample, info.qos.depth)

    def _on_trigger(self, reason: str) -> None:
        self._triggered_at = self._now()
        if self._file is not None:
            self._log.info("triggered again: %s", reason)
            return
        self._open(reason)
        for sample in self._ring:
            self._write(sample, sample.received_ns)
        self._log.info("triggered: %s: writing %s", reason, self._file.path if self._file else "")

    def _on_pause(self) -> None:
        if not self._paused:
            self._paused, self._paused_at = True, self._now()

    def _on_resume(self) -> None:
        if self._paused:
            self._paused = False
            if self.continuous:
                now = self._now()
                for sample in self._latched.messages(self._paused_at):
                    self._write(sample, now)

    def _split(self) -> None:
        if self._file is not None:
            self._close_file()
            if self.continuous:
                self._open("")

    def _limit_file(self, now: int) -> None:
        file, settings = self._file, self.settings
        assert file is not None
        if not self.continuous and has_passed(settings.after_s, self._triggered_at, now):
            self._close_file()
            return
        limit = settings.disk_limit_mb * _MIB
        longest = settings.split_mb * _MIB
        if limit:
            longest = min(longest, limit // 4)
        if file.size >= longest or now - file.started_ns >= settings.split_s * SECOND:
            self._close_file()
            self._open("" if self.continuous else "continued")
        self._remove_oldest(limit)

    def _remove_oldest(self, limit: int) -> None:
        size = sum(self._files.values()) + (self._file.size if self._file else 0)
        while limit and size > limit and self._files:
            path = next(iter(self._files))
            size -= self._files.pop(path)
            with suppress(OSError):
                path.unlink(missing_ok=True)

    def _open(self, reason: str) -> RecordingFile:
        """Begin and return a new file with the latched messages of before; raises `OSError`."""
        now = self._now()
        file = self._file = self._create(now, reason)
        self._noted = (0, 0)
        for sample in self._latched.messages():
            if self._tap is not None and self._tap.is_present(sample.gid):
                self._write(sample, now)
        return file

    def _create(self, now: int, reason: str) -> RecordingFile:
        stem, suffix = self._path.stem, self._path.suffix
        for number in range(self._next_number, _MOST_FILES):
            name = self._path.name if number == 1 else f"{stem}_{number}{suffix}"
            try:
                file = RecordingFile(
                    self._path.with_name(name),
                    now,
                    self._attachments,
                    self._find_message,
                    compression=self.settings.compression,
                    keep_free=self.settings.keep_free_mb * _MIB,
                    metadata={"trigger": reason} if reason else {},
                )
            except FileExistsError:
                continue
            self._next_number = number + 1
            return file
        raise FileExistsError(errno.EEXIST, f"all names to {stem}_{_MOST_FILES}{suffix} are taken")

    def _save(self) -> None:
        if self._file is None:
            return
        now, tap = self._now(), self._tap
        lost = {} if tap is None else self._lost(tap)
        losses = sum(self._dropped.values()), sum(lost.values())
        if losses != self._noted and has_passed(_LOSSES_S, self._noted_at, now):
            self._note_losses(losses, lost)
        if self._file.unsaved:
            self._file.save()

    def _note_losses(self, losses: tuple[int, int], lost: Mapping[str, int]) -> None:
        assert self._file is not None
        self._file.add_losses(dict(self._dropped), lost)
        self._noted, self._noted_at = losses, self._now()

    def _close_file(self) -> None:
        file, self._file = self._file, None
        if file is None:
            return
        tap = self._tap
        lost = {} if tap is None else self._lost(tap)
        try:
            if sum(self._dropped.values()) or lost:
                file.add_losses(dict(self._dropped), lost)
            file.close()
        except OSError as error:
            self._dropped += file.unsaved
            self._messages -= sum(file.unsaved.values())
            self._problem = f"{file.path} ends early: {explain_os_error(error)}"
            self._log.error("recording incomplete: %s", self._problem)
        self._messages += file.messages
        self._files[file.path] = file.path.stat().st_size if file.path.exists() else 0

    def _recovered(self) -> bool:
        """Try again what the disk did not take; return whether it takes it now."""
        try:
            if self._file is not None:
                self._file.save()
            elif self.continuous:
                self._open("")
        except OSError as error:
            self._report_disk(error)
            return False
        self._log.info("recording continues: the disk takes data again")
        self._problem = ""
        return True

    def _report_disk(self, error: OSError) -> None:
        self._disk_failed_at = self._now()
        path = self._file.path if self._file is not None else self._path
        problem = f"{path}: nothing can be written: {explain_os_error(error)}"
        if problem != self._problem:
            self._log.error("recording interrupted: %s; it continues when that is solved", problem)
        self._problem = problem

    def _request(self, call: Callable[[], None]) -> None:
        """Have `call` made by the thread that writes; wait for that, unless the disk is slow."""
        made = threading.Event()

        def request() -> None:
            try:
                call()
            finally:
                made.set()

        with self._lock:
            self._queue.append(request)
        self._bell.ring()
        if self._thread is not None:
            made.wait(_REQUEST_S)

    def _info(self, gid: bytes) -> PublisherInfo | None:
        return None if self._tap is None else self._tap.publisher(gid)

    def _is_wanted(self, topic: str) -> bool:
        """Return whether a topic is recorded, or a trigger needs it."""
        wanted = self._is_recorded(topic) or self._triggers.needs(topic)
        if len(self._wanted) < _MOST_TOPICS:
            self._wanted[topic] = wanted
        return wanted

    def _is_recorded(self, topic: str) -> bool:
        return self._include.match(topic) and not self._exclude.match(topic)

    def _is_repeated(self, sample: Sample) -> bool:
        """Return whether the same message is recorded under the robot's own name of its topic."""
        info = self._info(sample.gid)
        own = None if info is None else own_name(info.node, sample.topic)
        return own is not None and self._is_recorded(own)

    def _lost(self, tap: Tap) -> dict[str, int]:
        return {
            topic: count for topic, count in tap.lost.copy().items() if self._is_recorded(topic)
        }

    def _existing(self) -> dict[Path, int]:
        """Return the files of earlier recordings of this name with their sizes, oldest first."""
        own = re.compile(re.escape(self._path.stem) + r"(_\d+)?" + re.escape(self._path.suffix))
        found = []
        with suppress(OSError):
            for path in self._path.parent.iterdir():
                if own.fullmatch(path.name):
                    stat = path.stat()
                    found.append((stat.st_mtime_ns, path, stat.st_size))
        return {path: size for _, path, size in sorted(found)}
