"""The eight moments of figure 10: how a map is trusted, doubted, and repaired."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import Pose
from cairn.schemas.cairn_msgs import VisualMapChange
from cairn.tools.experiments.series import Change, Evidence, Mapped, Move, PairSeries, WorldSeries

Array = NDArray[np.float64]
T = TypeVar("T")

# The object of the paper's panels (b) and (c); where it is never recognized, the first that is.
_PAPERS_OBJECT = 7
# Reliability that (c) waits for: 0.5 after one similarity of 0.9.
_RELIED_ON = 0.9 - 1e-6
_NEW_SAMPLES = 300
_DISAGREES = 1  # cairn_msgs/ObjectEvidence


@dataclass(frozen=True)
class Moment:
    """One map: what it shows, when [s], the objects, and where the robot believes to be.

    `samples` (n, 2) [m] are new ones around the object `of`; None if none are drawn. A moment that
    never came has no stamp.
    """

    letter: str
    title: str
    stamp: float | None = None
    objects: tuple[Mapped, ...] = ()
    robot: Pose | None = None
    of: int | None = None
    samples: Array | None = None


def sequence_of(pair: PairSeries, world: WorldSeries) -> list[Moment]:
    """The moments (a) to (h) of a run, as far as they came."""
    return [_at(moment, pair) for moment in _moments(pair, world)]


def ring(center: tuple[float, float], radius: float, seed: int) -> Array:
    """New samples (n, 2) [m] as the paper draws them: around an object, as far as it was seen."""
    random = np.random.default_rng(seed)
    around = random.uniform(-math.pi, math.pi, _NEW_SAMPLES)
    reach = radius + (0.02 + 0.01 * radius**2) * random.standard_normal(_NEW_SAMPLES)
    return np.column_stack((center[0] + reach * np.cos(around), center[1] + reach * np.sin(around)))


def _moments(pair: PairSeries, world: WorldSeries) -> Iterator[Moment]:
    begin = pair.mapped[0].stamp if pair.mapped else None
    yield Moment("a", "all reliabilities at first", begin)
    first = _first_recognized(pair)
    yield _new_samples("b", "new samples around object {}, just recognized", pair, first)
    yield _relied_on(pair, first)
    move = world.moves[0] if world.moves else None
    if move is None:
        yield from (Moment(letter, "nothing was moved") for letter in "defgh")
        return
    yield Moment("d", "all objects seen are relied on", math.nextafter(move.stamp, 0.0))
    name = move.object_id
    doubt = _next(
        one
        for one in pair.evidence
        if one.object_id == name and one.stamp > move.stamp and one.verdict == _DISAGREES
    )
    yield _new_samples("e", "object {} is moved: new samples at its old place", pair, doubt)
    yield _doubted(pair, move, doubt)
    removal = _change(pair, VisualMapChange.REMOVED, name, move.stamp)
    yield _found_again(pair, removal)
    since = removal.stamp if removal else math.inf
    found = _change(pair, VisualMapChange.REGISTERED, name, since)
    yield Moment("h", f"object {name} registered at its new place", found.stamp if found else None)


def _first_recognized(pair: PairSeries) -> Evidence | None:
    mine = (one for one in pair.evidence if one.object_id == _PAPERS_OBJECT)
    return _next(mine) or _next(iter(pair.evidence))


def _relied_on(pair: PairSeries, first: Evidence | None) -> Moment:
    if first is None:
        return Moment("c", "nothing was recognized")
    name = first.object_id
    risen = _next(
        one
        for one in pair.mapped
        if one.object_id == name and one.stamp >= first.stamp and one.reliability >= _RELIED_ON
    )
    if risen is None:
        return Moment("c", f"object {name} relied on")
    title = f"reliability of object {name} rises to {risen.reliability:.2f}"
    return Moment("c", title, risen.stamp)


def _doubted(pair: PairSeries, move: Move, doubt: Evidence | None) -> Moment:
    before = pair.map_at(move.stamp).get(move.object_id)
    since = doubt.stamp if doubt else math.inf
    fallen = _next(
        one
        for one in pair.mapped
        if one.object_id == move.object_id
        and one.stamp >= since
        and before is not None
        and one.reliability < min(0.5, before.reliability)
    )
    title = f"reliability of object {move.object_id} falls"
    if fallen is None:
        return Moment("f", title)
    return Moment("f", f"{title} to {fallen.reliability:.2f}", fallen.stamp)


def _found_again(pair: PairSeries, removal: Change | None) -> Moment:
    """Removed, and new samples around where it was seen."""
    title = "object {} removed: new samples at its new place"
    if removal is None:
        return Moment("g", title.format("moved"))
    seen = [one for one in pair.evidence if one.object_id == removal.object_id]
    last = _next(one for one in seen if one.stamp >= removal.stamp)
    title = title.format(removal.object_id)
    if last is None:
        return Moment("g", title, removal.stamp)
    samples = ring(last.place, last.range_m, 2)
    return Moment("g", title, removal.stamp, of=removal.object_id, samples=samples)


def _new_samples(letter: str, title: str, pair: PairSeries, seen: Evidence | None) -> Moment:
    """New samples around an object where the map has it."""
    if seen is None:
        return Moment(letter, title.format("moved"))
    title = title.format(seen.object_id)
    mapped = pair.map_at(seen.stamp).get(seen.object_id)
    samples = ring(mapped.place, seen.range_m, 1) if mapped else None
    return Moment(letter, title, seen.stamp, of=seen.object_id, samples=samples)


def _at(moment: Moment, pair: PairSeries) -> Moment:
    """The moment, with the map and the robot as they were then."""
    if moment.stamp is None or not pair.stamps.size:
        return moment
    # The map before the evidence of (b) and (e) is in it.
    stamp = math.nextafter(moment.stamp, 0.0) if moment.letter in "be" else moment.stamp
    index = min(int(np.searchsorted(pair.stamps, moment.stamp)), pair.stamps.size - 1)
    x, y, theta = pair.poses[index].tolist()
    return Moment(
        moment.letter,
        moment.title,
        moment.stamp,
        tuple(pair.map_at(stamp).values()),
        (x, y, theta),
        moment.of,
        moment.samples,
    )


def _change(pair: PairSeries, kind: int, object_id: int, since: float) -> Change | None:
    return _next(
        one
        for one in pair.changes
        if one.kind == kind and one.object_id == object_id and one.stamp >= since
    )


def _next(items: Iterable[T]) -> T | None:
    return next(iter(items), None)
