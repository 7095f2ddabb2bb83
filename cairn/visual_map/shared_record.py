"""The record that robots with the same map share: what each of them knows about each landmark.

A **life** is the stay of an object at one position; a **contribution** is all that one robot has to
state about the present life of one object. Two records are merged by taking, for each object, the
contributions about its latest life, and of these the newest one of each robot. Both are maxima of
total orders, so merging is commutative, associative and idempotent: records that have received the
same contributions are equal, whatever the order, the repetitions and the detours. Nothing here
depends on a bus or a clock; docs/concepts/sharing.md has the reasons.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

from cairn.visual_map.landmarks import FARTHEST_M, MapPosition

MOST_ROBOTS: Final = 64
"""Robots that contribute to one record."""

_MOST_ID: Final = 2**32 - 1
MOST_STAMP_NS: Final = 2**62  # the year 2116
_MOST_COVARIANCE: Final = 1e14
# 64 robots that are as certain as a landmark can be (0.98: 3.9) sum up to 250.
MOST_LOG_ODDS: Final = 1e3
MOST_INFORMATION: Final = 1e15  # 1/m^2
_NAME: Final = re.compile(r"[a-z][a-z0-9_]{0,62}")


@dataclass(frozen=True, order=True)
class Life:
    """The stay of an object at one position, from its registration there by `robot`.

    `began_ns` is the time of the robot's clock, but later than that of any life of the object that
    the robot knew (a hybrid logical clock, Kulkarni 2014): a life always replaces those that its
    robot knew, however wrong the clocks are. The life in the original map is `ORIGINAL`.
    """

    began_ns: int
    robot: str


ORIGINAL: Final = Life(0, "")
"""The life that an object has in the map from which all robots started."""


@dataclass(frozen=True)
class PositionInformation:
    """What observations add to a position: information matrix [1/m^2] and vector [1/m].

    The vector is relative to the position at which the life began.
    """

    xx: float = 0.0
    xy: float = 0.0
    yy: float = 0.0
    x: float = 0.0
    y: float = 0.0

    def plus(self, other: PositionInformation, sign: float = 1.0) -> PositionInformation:
        """Return the sum, or with `sign` -1 the difference."""
        return PositionInformation(
            self.xx + sign * other.xx,
            self.xy + sign * other.xy,
            self.yy + sign * other.yy,
            self.x + sign * other.x,
            self.y + sign * other.y,
        )


NO_INFORMATION: Final = PositionInformation()


@dataclass(frozen=True)
class Contribution:
    """What `robot` has found out about the life `life` of the object `object_id`.

    Attributes:
        version: counts the robot's contributions; a later one replaces an earlier one.
        stamp_ns: time of the newest evidence by the robot's clock [ns].
        registered: where the life began [m, m^2]; None for `ORIGINAL`, which the map has.
        removed: whether the robot has found that the object is no longer there.
        log_odds: sum of the robot's evidence, by equation 2 of the paper.
        information: what the robot's observations add to the position.
    """

    robot: str
    object_id: int
    version: int
    stamp_ns: int
    life: Life
    registered: MapPosition | None
    removed: bool
    log_odds: float
    information: PositionInformation = NO_INFORMATION

    @property
    def subject(self) -> int:
        """Return what distinguishes it from the other contributions of its robot."""
        return self.object_id

    @property
    def content(self) -> tuple[Any, ...]:
        """Return all its values as a tuple that can be compared with any other one's."""
        at = self.registered
        place = () if at is None else _plain(at.x, at.y, at.xx, at.xy, at.yy)
        found = self.information
        sums = _plain(self.log_odds, found.xx, found.xy, found.yy, found.x, found.y)
        began = (self.life.began_ns, self.life.robot)
        return (
            self.robot,
            self.object_id,
            self.version,
            self.stamp_ns,
            began,
            place,
            self.removed,
            sums,
        )

    @property
    def rank(self) -> tuple[Any, ...]:
        """Return its rank among the contributions of one robot about one object.

        The content makes the order total, so that two different contributions of one version, as of
        two robots that have one name by mistake, are merged alike everywhere.
        """
        return self.life, self.version, self.content


def check_contribution(one: Contribution) -> None:
    """Raise `ValueError` with the value that no robot contributes."""
    life, at, found = one.life, one.registered, one.information
    check_robot_name(one.robot)
    _check("object", one.object_id, 0, _MOST_ID)
    _check("version", one.version, 1, MOST_STAMP_NS)
    _check("stamp", one.stamp_ns, 0, MOST_STAMP_NS)
    _check("log-odds", one.log_odds, -MOST_LOG_ODDS, MOST_LOG_ODDS)
    for value in (found.xx, found.xy, found.yy, found.x, found.y):
        _check("information", value, -MOST_INFORMATION, MOST_INFORMATION)
    if life == ORIGINAL:
        if at is not None:
            raise ValueError("it has a position for the life in the original map")
        return
    check_robot_name(life.robot)
    _check("begin of its life", life.began_ns, 1, MOST_STAMP_NS)
    if at is None:
        raise ValueError("its life has no position")
    for value in (at.x, at.y):
        _check("position", value, -FARTHEST_M, FARTHEST_M)
    for value in (at.xx, at.yy):
        _check("covariance", value, 0.0, _MOST_COVARIANCE)
    if not at.xy**2 <= at.xx * at.yy * (1 + 1e-9):
        raise ValueError(f"({at.xx}, {at.xy}, {at.yy}) is not a covariance")


def check_robot_name(name: str) -> None:
    """Raise `ValueError` unless a text is the name of a robot."""
    if not _NAME.fullmatch(name):
        raise ValueError(f"{name[:80]!r} is not the name of a robot")


@dataclass(frozen=True)
class ContributorSummary:
    """How many contributions of a robot a record has, the newest version, and their digest.

    Two records with equal digests have the same contributions of this robot.
    """

    robot: str
    newest: int
    count: int
    digest: int


class SharedRecord:
    """The contributions of all robots to the landmarks of one map."""

    def __init__(self, contributions: Iterable[Contribution] = ()) -> None:
        self._objects: dict[int, dict[str, Contribution]] = {}
        self._newest: dict[str, int] = {}
        self._count: dict[str, int] = {}
        self._summaries: dict[str, ContributorSummary] = {}
        self.merge(contributions)

    def __iter__(self) -> Iterator[Contribution]:
        """Yield all contributions by object and robot."""
        for object_id in sorted(self._objects):
            yield from self.about(object_id)

    def __contains__(self, object_id: int) -> bool:
        return object_id in self._objects

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SharedRecord) and self._objects == other._objects

    __hash__ = None  # type: ignore[assignment]  # it changes

    @property
    def robots(self) -> list[str]:
        """Return the names of the robots of which it has contributions."""
        return sorted(self._count)

    @property
    def objects(self) -> list[int]:
        """Return the objects of which it has contributions."""
        return sorted(self._objects)

    def about(self, object_id: int) -> list[Contribution]:
        """Return the contributions about an object, by robot; all are of one life."""
        known = self._objects.get(object_id, {})
        return [known[robot] for robot in sorted(known)]

    def of(self, robot: str) -> list[Contribution]:
        """Return the contributions of a robot, by object."""
        if robot not in self._count:
            return []
        known = (self._objects[object_id].get(robot) for object_id in sorted(self._objects))
        return [one for one in known if one is not None]

    def next_version(self, robot: str) -> int:
        """Return a version that is greater than those of all contributions of the robot."""
        return min(self._newest.get(robot, 0) + 1, MOST_STAMP_NS)

    def merge(self, contributions: Iterable[Contribution]) -> set[int]:
        """Take in contributions of any age and order; return the objects for which it matters."""
        return {one.object_id for one in contributions if self._take(one)}

    def summaries(self) -> list[ContributorSummary]:
        """Return the summary of each robot's contributions, by robot."""
        for robot in self.robots:
            if robot not in self._summaries:
                self._summaries[robot] = self._summarize(robot)
        return [self._summaries[robot] for robot in self.robots]

    def _take(self, one: Contribution) -> bool:
        known = self._objects.setdefault(one.object_id, {})
        life = next((other.life for other in known.values()), one.life)
        if one.life < life:
            return False
        if one.life > life:
            for robot in known:
                self._note(robot, -1)
            known.clear()
        mine = known.get(one.robot)
        if mine is not None and one.rank <= mine.rank:
            return False
        known[one.robot] = one
        self._newest[one.robot] = max(self._newest.get(one.robot, 0), one.version)
        self._note(one.robot, 1 if mine is None else 0)
        return True

    def _note(self, robot: str, added: int) -> None:
        self._summaries.pop(robot, None)
        self._count[robot] = self._count.get(robot, 0) + added
        if not self._count[robot]:
            del self._count[robot], self._newest[robot]

    def _summarize(self, robot: str) -> ContributorSummary:
        digest = hashlib.blake2b(digest_size=8)
        known = self.of(robot)
        for one in known:
            digest.update(repr(one.content).encode())
        newest = max(one.version for one in known)
        return ContributorSummary(robot, newest, len(known), int.from_bytes(digest.digest()))


def _plain(*values: float) -> tuple[float, ...]:
    # SQLite returns no minus before 0.
    return tuple(float(value) + 0.0 for value in values)


def _check(name: str, value: float, low: float, high: float) -> None:
    if not (math.isfinite(value) and low <= value <= high):
        raise ValueError(f"its {name} {value} is not from {low:g} to {high:g}")
