"""The transform buffer: trees of frames with a history, as `tf2::BufferCore` keeps them."""

from __future__ import annotations

import logging
import operator
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from difflib import get_close_matches

from cairn.schemas.builtin_interfaces import to_ns
from cairn.schemas.geometry_msgs import TransformStamped
from cairn.schemas.tf2_msgs import TFMessage
from cairn.system.clock import SECOND
from cairn.tf import rigid_motion
from cairn.tf.errors import (
    BufferFullError,
    ConnectivityError,
    ExtrapolationError,
    InvalidArgumentError,
    TransformError,
    UnknownFrameError,
)
from cairn.tf.frame_history import FrameHistory
from cairn.tf.transform import Transform, checked_motion

_log = logging.getLogger("cairn.tf")

_LONGEST_NAME = 255  # of a frame [characters]
_MOST_LISTED = 20  # frames in an error
_MOST_REPORTS = 1_000  # problems, each of which is reported once

_Edge = tuple[FrameHistory, int]
"""A frame, and the index of its transform to the parent."""
_Failure = Callable[[], TransformError]
"""Makes the error: its text takes longer than to find out that there is one."""


@dataclass(frozen=True, slots=True)
class FrameInfo:
    """A frame as a buffer knows it.

    Attributes:
        name: its name.
        parent: its newest parent; None for the root of a tree.
        is_static: whether its transform holds at all times.
        publisher: what published its newest transform; empty if that is unknown.
        transforms: number of transforms in the buffer.
        oldest_ns: stamp of the oldest of them [ns]; None without one, and for a static transform.
        newest_ns: stamp of the newest of them [ns]; None as `oldest_ns`.
    """

    name: str
    parent: str | None
    is_static: bool
    publisher: str
    transforms: int
    oldest_ns: int | None
    newest_ns: int | None

    @property
    def rate_hz(self) -> float | None:
        """Mean rate of the stamps [1/s]; None with fewer than two transforms."""
        if self.oldest_ns is None or self.newest_ns is None or self.transforms < 2:
            return None
        return (self.transforms - 1) * SECOND / (self.newest_ns - self.oldest_ns)


class Buffer:
    """Transforms between frames over time; lookups at a time interpolate.

    A component adds what its ports receive:

    ```python
    @on("tf")
    def on_tf(self, message: TFMessage) -> None:
        self.transforms.add(message, static=False)

    @on("tf_static")
    def on_tf_static(self, message: TFMessage) -> None:
        self.transforms.add(message, static=True)
    ```

    It may be used by several threads. No method waits for a transform.
    """

    def __init__(
        self,
        cache_s: float = 10.0,
        *,
        max_frames: int = 4096,
        max_transforms: int = 500_000,
        max_transforms_of_frame: int = 10_000,
        on_problem: Callable[[str], None] = _log.warning,
    ) -> None:
        """Create an empty buffer.

        Args:
            cache_s: how long transforms are kept, before the newest one of the same frame [s].
            max_frames: largest number of frames; transforms with further ones are rejected.
            max_transforms: largest number of transforms, of 68 bytes each. With more, the oldest
                ones of the frames that have the most are dropped.
            max_transforms_of_frame: the same for each frame.
            on_problem: called once about each problem of a frame, such as two parents, on the
                thread that adds the transform; by default it is logged.

        Raises:
            InvalidArgumentError: if a limit is not positive.
        """
        limits = (cache_s, max_frames, max_transforms, max_transforms_of_frame)
        if not all(limit > 0 for limit in limits):
            raise InvalidArgumentError(
                f"transform buffer: the limits {limits} are not all positive; give larger ones"
            )
        self._cache_ns = round(cache_s * SECOND)
        self._max_frames = max_frames
        self._max_transforms = max_transforms
        self._max_of_frame = max_transforms_of_frame
        self._on_problem = on_problem
        self._lock = threading.Lock()
        self._by_name: dict[str, FrameHistory] = {}
        self._frames: list[FrameHistory] = []  # by their numbers
        self._transforms = 0
        self._reported: set[tuple[str, str]] = set()
        self._rejected = 0

    @property
    def rejected(self) -> int:
        """Number of transforms that `add` has rejected, and that were too old."""
        return self._rejected

    def add(self, message: TFMessage, *, static: bool, publisher: str = "") -> None:
        """Add the transforms of a message; reject, count and report those that are not valid.

        Args:
            message: from a topic `tf` or `tf_static`.
            static: whether the transforms hold at all times, as those of `tf_static`.
            publisher: what published the message, for `frames` and reports.
        """
        for transform in message.transforms:
            try:
                self.set_transform(transform, static=static, publisher=publisher)
            except TransformError as error:
                with self._lock:
                    self._rejected += 1
                kind = type(error).__name__
                frame = (
                    transform.child_frame_id[:_LONGEST_NAME] if kind != "BufferFullError" else ""
                )
                self._report((kind, frame), f"rejected transform: {error}")

    def set_transform(
        self, transform: TransformStamped, *, static: bool = False, publisher: str = ""
    ) -> None:
        """Add a transform; a leading slash of its frame names is removed, as in tf2.

        A transform that is older than `cache_s` before the frame's newest one is dropped and
        reported. If a frame gets another parent or another publisher, the newest transform counts,
        which is reported.

        Raises:
            InvalidArgumentError: if a number is not finite, the quaternion is not normalized, a
                frame name is empty or too long, or a frame is its own parent.
            BufferFullError: if the buffer has its largest number of frames.
        """
        parent = transform.header.frame_id.removeprefix("/")
        child = transform.child_frame_id.removeprefix("/")
        for name, role in ((parent, "header.frame_id"), (child, "child_frame_id")):
            if not name or len(name) > _LONGEST_NAME:
                raise InvalidArgumentError(
                    f"transform {parent[:80]!r} -> {child[:80]!r}: {role} has {len(name)} "
                    f"characters; name a frame with 1 to {_LONGEST_NAME} characters"
                )
        if parent == child:
            raise InvalidArgumentError(
                f"transform {parent!r} -> {child!r}: a frame cannot be its own parent; name two "
                "different frames"
            )
        moved, turned = transform.transform.translation, transform.transform.rotation
        try:
            motion = checked_motion(
                (moved.x, moved.y, moved.z), (turned.x, turned.y, turned.z, turned.w)
            )
        except InvalidArgumentError as error:
            raise InvalidArgumentError(f"transform {parent!r} -> {child!r}: {error}") from error
        stamp = to_ns(transform.header.stamp)
        with self._lock:
            problems = self._insert(parent, child, stamp, motion, static, publisher)
        for key, text in problems:
            self._report(key, text)

    def clear(self) -> None:
        """Drop all transforms that are not static, as after time was set back.

        Until then, transforms from before the jump hide those of the new time. Problems are
        reported again.
        """
        with self._lock:
            kept = [frame for frame in self._frames if frame.is_static]
            names = {frame.number: frame.name for frame in self._frames}
            self._by_name, self._frames = {}, []
            self._transforms = len(kept)
            self._reported = set()
            for old in kept:
                parent = self._frame(names[old.parent_at(0)])
                frame = self._frame(old.name)
                frame.set_static(old.stamps[0], parent.number, old.motion_at(0, None))
                frame.publisher = old.publisher

    def lookup(self, target: str, source: str, time_ns: int | None = None) -> Transform:
        """Return the transform target <- source, which maps points of the source to the target.

        Between two transforms of a frame, the translation is interpolated linearly and the rotation
        by slerp.

        Args:
            target: name of the target frame.
            source: name of the source frame.
            time_ns: time of the transform [ns]; None stands for the newest time for which all
                frames on the path have a transform, `newest_common_time`.

        Raises:
            UnknownFrameError: if no transform names one of the frames.
            ConnectivityError: if the frames are in different trees.
            ExtrapolationError: if the time is before the oldest or after the newest transform of a
                frame on the path.
            InvalidArgumentError: if a name is empty or begins with a slash, or the time is not an
                integer.
        """
        time_ns = _checked(target, source, time_ns)
        with self._lock:
            path = self._path(target, source, time_ns)
            if not isinstance(path, _Path):
                raise path()
            return Transform.from_motion(path.motion())

    def lookup_full(
        self,
        target: str,
        target_time_ns: int | None,
        source: str,
        source_time_ns: int | None,
        fixed_frame: str,
    ) -> Transform:
        """Return target at one time <- source at another time, by way of a fixed frame.

        The fixed frame is one that does not move between the times, such as `odom` or `map`. Times
        and errors are as in `lookup`.
        """
        earlier = self.lookup(fixed_frame, source, source_time_ns)
        return self.lookup(target, fixed_frame, target_time_ns) @ earlier

    def can_transform(self, target: str, source: str, time_ns: int | None = None) -> bool:
        """Return whether `lookup` with these arguments succeeds now; it does not wait.

        Raises `InvalidArgumentError` as `lookup`.
        """
        time_ns = _checked(target, source, time_ns)
        with self._lock:
            return isinstance(self._path(target, source, time_ns), _Path)

    def newest_common_time(self, target: str, source: str) -> int | None:
        """Return the newest time for which all frames on the path have a transform [ns].

        Returns None if all transforms on the path are static. Raises as `lookup`.
        """
        _checked(target, source, None)
        with self._lock:
            path = self._path(target, source, None)
            if not isinstance(path, _Path):
                raise path()
            return path.time_ns

    def frames(self) -> dict[str, FrameInfo]:
        """Return all frames by their names, sorted; also those that are only parents."""
        with self._lock:
            return {
                name: _info(frame, self._frames) for name, frame in sorted(self._by_name.items())
            }

    def _insert(
        self,
        parent_name: str,
        child_name: str,
        stamp: int,
        motion: rigid_motion.Motion,
        static: bool,
        publisher: str,
    ) -> list[tuple[tuple[str, str], str]]:
        """Add a valid transform; return the problems to report, each with its key."""
        new = (parent_name not in self._by_name) + (child_name not in self._by_name)
        if len(self._frames) + new > self._max_frames:
            raise BufferFullError(
                f"transform {parent_name!r} -> {child_name!r}: the buffer has {len(self._frames)} "
                "frames, its largest number; look for a publisher that invents frame names, or "
                "create the buffer with a larger max_frames"
            )
        parent, child = self._frame(parent_name), self._frame(child_name)
        problems = []
        if child.newest_parent is not None:
            if child.is_static != static:
                kinds = ("static", "changing") if child.is_static else ("changing", "static")
                problems.append((
                    ("kind", child_name),
                    f"{child_name}: its transform was {kinds[0]}{_by(child.publisher)} and is now "
                    f"{kinds[1]}{_by(publisher)}; publish it on tf or on tf_static, not on both",
                ))  # fmt: skip
            elif child.newest_parent != parent.number:
                before = self._frames[child.newest_parent].name
                problems.append((
                    ("parent", child_name),
                    f"{child_name}: its parent was {before}{_by(child.publisher)} and is now "
                    f"{parent_name}{_by(publisher)}; the newest transform counts. Let one "
                    "component publish the transform of each frame",
                ))  # fmt: skip
            elif publisher and child.publisher not in ("", publisher):
                problems.append((
                    ("publisher", child_name),
                    f"{child_name}: its transform was published by {child.publisher} and is now "
                    f"by {publisher}; the newest transform counts. Let one component publish the "
                    "transform of each frame",
                ))  # fmt: skip
        count = len(child)
        if static:
            child.set_static(stamp, parent.number, motion)
        else:
            if child.is_static:
                child.clear()
            elif child.stamps and stamp < child.stamps[-1] - self._cache_ns:
                self._rejected += 1
                problems.append((
                    ("old", child_name),
                    f"{child_name}: dropped a transform{_by(publisher)} of {_seconds(stamp)}, more "
                    f"than {self._cache_ns / SECOND:g} s before the newest one of "
                    f"{_seconds(child.stamps[-1])}; if time was set back, clear the buffer",
                ))  # fmt: skip
                return problems
            child.insert(stamp, parent.number, motion)
            child.drop_before(child.stamps[-1] - self._cache_ns)
            child.drop_oldest(max(0, len(child) - self._max_of_frame))
        child.publisher = publisher
        self._transforms += len(child) - count
        self._drop_surplus(child)
        return problems

    def _drop_surplus(self, changed: FrameHistory) -> None:
        """Drop the oldest transforms of the frames that have more than an equal share."""
        while self._transforms > self._max_transforms:
            share = self._max_transforms // len(self._frames)
            if len(changed) > share:
                surplus, count = changed, 1
            else:
                surplus = max(self._frames, key=len)
                count = len(surplus) - share
            surplus.drop_oldest(count)
            self._transforms -= count

    def _frame(self, name: str) -> FrameHistory:
        """Return the frame of a name, which is created if it is new."""
        frame = self._by_name.get(name)
        if frame is None:
            frame = self._by_name[name] = FrameHistory(name, len(self._frames))
            self._frames.append(frame)
        return frame

    def _report(self, key: tuple[str, str], text: str) -> None:
        with self._lock:
            if key in self._reported or len(self._reported) >= _MOST_REPORTS:
                return
            self._reported.add(key)
        self._on_problem(text)

    def _path(self, target: str, source: str, time_ns: int | None) -> _Path | _Failure:
        """Return the path of the transform target <- source, or what makes the error."""
        end, start = self._by_name.get(target), self._by_name.get(source)
        if end is None or start is None:
            unknown = target if end is None else source
            return lambda: self._unknown(unknown)
        if time_ns is None:
            newest = self._walk(end, start, None)
            if isinstance(newest, _Path):
                edges = (*newest.up, *newest.down)
                stamps = [frame.stamps[-1] for frame, _ in edges if not frame.is_static]
                if not stamps:
                    return newest
                time_ns = min(stamps)
        path = self._walk(end, start, time_ns)
        if isinstance(path, _Path):
            return path
        requested = time_ns
        return lambda: self._no_path(end, start, requested, path)

    def _walk(
        self, target: FrameHistory, source: FrameHistory, time_ns: int | None
    ) -> _Path | _Blocked:
        """Follow the parents at a time from both frames to the first common one."""
        frames = self._frames
        up: list[_Edge] = []
        passed = {source.number: 0}
        frame = source
        blocked: FrameHistory | None = None
        while frame is not target:
            index = frame.place(time_ns)
            if index is None:
                blocked = frame if frame.stamps else None
                break
            up.append((frame, index))
            frame = frames[frame.parent_at(index)]
            if frame.number in passed:
                return _Blocked(None, [one.name for one, _ in up[passed[frame.number] :]])
            passed[frame.number] = len(up)
        else:
            return _Path(up, [], time_ns)
        down: list[_Edge] = []
        visited = {target.number}
        frame = target
        while frame.number not in passed:
            index = frame.place(time_ns)
            if index is None:
                return _Blocked(blocked or (frame if frame.stamps else None), [])
            down.append((frame, index))
            frame = frames[frame.parent_at(index)]
            if frame.number in visited:
                names = [one.name for one, _ in down]
                return _Blocked(None, names[names.index(frame.name) :])
            visited.add(frame.number)
        return _Path(up[: passed[frame.number]], down, time_ns)

    def _unknown(self, name: str) -> UnknownFrameError:
        known = sorted(self._by_name)
        close = get_close_matches(name, known, n=1)
        guess = f"did you mean {close[0]}? There" if close else "there"
        return UnknownFrameError(f"there is no frame {name}; {guess} are: {_listed(known)}")

    def _no_path(
        self, target: FrameHistory, source: FrameHistory, time_ns: int | None, found: _Blocked
    ) -> TransformError:
        """Return the error for frames that no path connects at a time."""
        if found.loop:
            return ConnectivityError(
                f"{source.name} and {target.name}: the frames {_listed(found.loop)} form a loop; "
                "correct the component that publishes a wrong parent"
            )
        newest = self._walk(target, source, None)
        if found.frame is None or time_ns is None or not isinstance(newest, _Path):
            return ConnectivityError(
                f"{source.name} and {target.name} are not connected: they are in the trees of "
                f"{self._root_name(source)} and {self._root_name(target)}; publish a transform "
                "between these (`cairn tf tree` shows the trees)"
            )
        edges = (frame for frame, _ in (*newest.up, *newest.down))
        frame = next((one for one in edges if one.place(time_ns) is None), found.frame)
        parent = self._frames[frame.parent_at(len(frame) - 1)].name
        oldest, last = frame.stamps[0], frame.stamps[-1]
        if time_ns > last:
            bound, off = f"the newest one is of {_seconds(last)}", time_ns - last
            remedy = "request an earlier time, or None for the newest common one, or wait for it"
        else:
            bound, off = f"the oldest one is of {_seconds(oldest)}", oldest - time_ns
            cache = f"{self._cache_ns / SECOND:g} s"
            remedy = f"request a later time, or create the buffer with more than cache_s={cache}"
        return ExtrapolationError(
            f"{parent} -> {frame.name}: there is no transform at {_seconds(time_ns)}: {bound}, "
            f"{_seconds(off)} {'before' if time_ns > last else 'after'} that; {remedy}",
            parent,
            frame.name,
            time_ns,
            oldest,
            last,
        )

    def _root_name(self, frame: FrameHistory) -> str:
        """Return the name of the root above a frame by the newest parents."""
        passed = set()
        while (parent := frame.newest_parent) is not None and frame.number not in passed:
            passed.add(frame.number)
            frame = self._frames[parent]
        return frame.name


@dataclass(frozen=True, slots=True)
class _Path:
    """Edges from the source up to the common frame, and from the target up to it, at a time."""

    up: list[_Edge]
    down: list[_Edge]
    time_ns: int | None

    def motion(self) -> rigid_motion.Motion:
        """Return target <- source."""
        motion = self._climb(self.up)
        if self.down:
            back = rigid_motion.invert(self._climb(self.down))
            motion = rigid_motion.compose(back, motion)
        return motion

    def _climb(self, edges: Iterable[_Edge]) -> rigid_motion.Motion:
        """Return the common frame <- the first frame of the edges."""
        motion = rigid_motion.IDENTITY
        for frame, index in edges:
            motion = rigid_motion.compose(frame.motion_at(index, self.time_ns), motion)
        return motion


@dataclass(frozen=True, slots=True)
class _Blocked:
    """Why there is no path: a frame without a transform at the time, or frames that form a loop."""

    frame: FrameHistory | None
    loop: list[str]


def _checked(target: str, source: str, time_ns: int | None) -> int | None:
    """Return the time [ns] of a lookup; raise `InvalidArgumentError` if an argument is invalid."""
    for name in (target, source):
        if not name or name[0] == "/":
            raise InvalidArgumentError(
                f"frame name {name!r} is empty or begins with a slash; name a frame as in base_link"
            )
    if time_ns is None:
        return None
    try:
        return operator.index(time_ns)  # also integers of NumPy
    except TypeError as error:
        raise InvalidArgumentError(
            f"time {time_ns!r} is not an integer; give nanoseconds, or None for the newest time"
        ) from error


def _info(frame: FrameHistory, frames: list[FrameHistory]) -> FrameInfo:
    parent = frame.newest_parent
    is_timed = bool(frame.stamps) and not frame.is_static
    return FrameInfo(
        name=frame.name,
        parent=None if parent is None else frames[parent].name,
        is_static=frame.is_static,
        publisher=frame.publisher,
        transforms=len(frame),
        oldest_ns=frame.stamps[0] if is_timed else None,
        newest_ns=frame.stamps[-1] if is_timed else None,
    )


def _by(publisher: str) -> str:
    return f" (from {publisher})" if publisher else ""


def _listed(names: list[str]) -> str:
    more = len(names) - _MOST_LISTED
    shown = ", ".join(names[:_MOST_LISTED]) or "none"
    return f"{shown} and {more} more" if more > 0 else shown


def _seconds(nanoseconds: int) -> str:
    """Return a time or a duration in seconds, exact to the nanosecond."""
    sign = "-" if nanoseconds < 0 else ""
    whole, part = divmod(abs(nanoseconds), SECOND)
    return f"{sign}{whole}.{part:09d} s"
