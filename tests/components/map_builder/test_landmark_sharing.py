"""Tests of the shared record: merging, equal maps after any history, and what robots adopt."""

import random
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn import CairnError
from cairn.components.map_builder.landmark_map import LandmarkKeeper
from cairn.components.map_builder.landmark_sharing import LandmarkSharing
from cairn.visual_map.landmarks import (
    ChangeKind,
    LandmarkRecord,
    LandmarkState,
    MapPosition,
)
from cairn.visual_map.new_map import write_map
from cairn.visual_map.shared_record import (
    ORIGINAL,
    Contribution,
    Life,
    PositionInformation,
    SharedRecord,
    check_contribution,
)
from tests.components.map_builder.evidence import HERE, THERE, observation, surveyed

S = 10**9
ROBOTS = ("ada", "ben", "cleo")


def lives() -> st.SearchStrategy[Life]:
    # Few values, so that lives and versions of equal rank occur.
    later = st.builds(Life, st.integers(1, 2), st.sampled_from(ROBOTS))
    return st.one_of(st.just(ORIGINAL), later)


@st.composite
def contributions(draw: st.DrawFn) -> Contribution:
    life = draw(lives())
    one = Contribution(
        draw(st.sampled_from(ROBOTS)),
        draw(st.integers(1, 2)),
        draw(st.integers(1, 3)),
        draw(st.integers(0, 2)),
        life,
        None if life == ORIGINAL else MapPosition(draw(st.floats(-9, 9)), 0.0, 0.1, 0.0, 0.1),
        removed=draw(st.booleans()),
        log_odds=draw(st.floats(-4, 4)),
        information=PositionInformation(draw(st.floats(0, 9)), 0.0, 1.0, 0.1, 0.2),
    )
    check_contribution(one)
    return one


@pytest.mark.accuracy
@settings(max_examples=200, deadline=None)
@given(*(st.lists(contributions(), max_size=8) for _ in range(3)))
def test_merging_is_commutative_associative_and_idempotent(
    a: list[Contribution], b: list[Contribution], c: list[Contribution]
) -> None:
    def merged(*parts: Sequence[Contribution] | SharedRecord) -> SharedRecord:
        record = SharedRecord()
        for part in parts:
            record.merge(list(part))
        return record

    assert merged(a, b) == merged(b, a)
    assert merged(merged(a, b), c) == merged(a, merged(b, c))
    assert merged(a, a) == merged(a)
    assert merged(a, merged(a, b)) == merged(a, b)
    assert merged(a, b, c).summaries() == merged(c, b, a).summaries()
    assert [*merged([*a, *b, *c])] == [*merged(c, a, b)]


class _Robot:
    """A robot that judges landmarks at random, and the messages that it has sent."""

    def __init__(self, name: str, originals: Sequence[LandmarkRecord]) -> None:
        self.sharing = LandmarkSharing(name, originals, ())
        self.map = {one.object_id: one for one in originals}

    def judge(self, chance: random.Random, now_ns: int) -> list[Contribution]:
        """Change a landmark as the rule may: less or more reliable, refined, removed, moved."""
        object_id = chance.choice((1, 2, 3))
        known = self.map.get(object_id)
        if known is None or known.state is LandmarkState.RELOCATING:
            position = MapPosition(chance.uniform(0, 9), chance.uniform(0, 9), 0.02, 0.0, 0.02)
            return self._set(LandmarkRecord(object_id, "it", position, 0.9), now_ns, True)
        assert known.position is not None
        what = chance.randrange(3)
        if what == 0:
            gone = replace(known, state=LandmarkState.RELOCATING, reliability=0.08)
            return self._set(gone, now_ns, False)
        reliability = chance.choice((0.2, 0.6, 0.98))
        position = known.position
        if what == 1:
            position = MapPosition(
                position.x + 0.01, position.y, position.xx * 0.9, position.xy, position.yy * 0.9
            )
        return self._set(replace(known, reliability=reliability, position=position), now_ns, False)

    def receive(self, sent: Sequence[Contribution]) -> None:
        before = {one.object_id: self.sharing.landmark(one.object_id) for one in sent}
        for object_id in self.sharing.record.merge(sent):
            adopted = self.sharing.adopted(self.map.get(object_id), object_id, before[object_id], 0)
            if adopted is not None:
                self.map[object_id] = adopted[0]

    def _set(self, one: LandmarkRecord, now_ns: int, registered: bool) -> list[Contribution]:
        self.map[one.object_id] = one
        sent = self.sharing.contribute(one, now_ns, registered=registered)
        now = self.sharing.landmark(one.object_id)
        adopted = self.sharing.adopted(one, one.object_id, now, 0)
        if adopted is not None:  # what the record gives is what the robot has found out
            after = adopted[0]
            assert after.state is one.state
            assert after.reliability == pytest.approx(one.reliability)
            assert one.position is not None
            assert after.position is not None
            assert after.position.distance(one.position) < 1e-9
            self.map[one.object_id] = after
        return [] if sent is None else [sent]

    @property
    def shared(self) -> list[tuple[object, ...]]:
        """What the map has, without what is each robot's own, such as candidates."""
        return [
            (key, one.position, one.reliability, one.state) for key, one in sorted(self.map.items())
        ]


def history(seed: int) -> None:
    """Let three robots judge and exchange messages that are lost, repeated and reordered.

    Then each receives everything once, in an order of its own.
    """
    chance = random.Random(seed)
    originals = [surveyed(1), surveyed(2)]
    robots = [_Robot(name, originals) for name in ROBOTS]
    errors_ns = [chance.choice((0, 3 * S, 3600 * S)) for _ in robots]  # of the clocks
    sent: list[Contribution] = []
    for step in range(chance.randrange(4, 16)):
        k = chance.randrange(3)
        now_ns = step * chance.choice((S, 600 * S)) + errors_ns[k]
        sent += robots[k].judge(chance, now_ns)
        if sent and chance.random() < 0.5:  # a partition otherwise
            chance.choice(robots).receive(chance.choices(sent, k=2))
    for robot in robots:
        robot.receive(chance.sample(sent, len(sent)))
    assert robots[0].sharing.record == robots[1].sharing.record == robots[2].sharing.record
    assert robots[0].shared == robots[1].shared == robots[2].shared, f"history {seed}"


def test_robots_have_equal_maps_after_random_histories() -> None:
    for seed in range(400):  # `python -m cairn_lab.benchmarks.sharing` runs 10,000
        history(seed)


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    path = tmp_path / "shared.cairn"
    write_map(path, "a test", [surveyed(6), surveyed(7)])
    return path


def _keeper(map_file: Path, robot: str) -> LandmarkKeeper:
    copy = map_file.with_name(f"{robot}.cairn")
    return LandmarkKeeper(map_file, copy, 10**18, robot=robot)


def _see_it_moved(keeper: LandmarkKeeper, at_s: int, times: int = 4) -> None:
    """Let a robot see that landmark 7 has moved from HERE to THERE."""
    keeper.apply(at_s * S, [observation(0.1, 0, THERE)])
    for step in range(1, times):
        keeper.apply((at_s + step) * S, [observation(0.9, step, THERE)])


def _state(keeper: LandmarkKeeper) -> LandmarkState:
    return keeper.landmarks[1].state


def _shown(keeper: LandmarkKeeper) -> list[tuple[object, ...]]:
    return [(o.object_id, o.position, o.reliability, o.state) for o in keeper.landmarks]


def test_other_robots_adopt_what_one_has_found_out(map_file: Path) -> None:
    ada, ben = _keeper(map_file, "ada"), _keeper(map_file, "ben")

    _see_it_moved(ada, 10, times=1)
    _, removed = ben.merge(11 * S, ada.take_contributions())
    _see_it_moved(ada, 20)
    matters, changes = ben.merge(30 * S, ada.take_contributions())

    ((version, change),) = removed
    assert (version, change.kind, change.object_id) == (3, ChangeKind.REMOVED, 7)
    assert change.reason == "ada found at 1970-01-01 00:00:10.000+00:00 that it is no longer there"
    assert matters
    assert [one.kind for _, one in changes] == [ChangeKind.REGISTERED]
    assert "ada registered it at its new position" in changes[0][1].reason
    assert _shown(ada) == _shown(ben)
    assert ben.landmarks[1].position != HERE


def test_repeated_contributions_change_nothing(map_file: Path) -> None:
    ada, ben = _keeper(map_file, "ada"), _keeper(map_file, "ben")
    _see_it_moved(ada, 10)
    sent = ada.take_contributions()
    ben.merge(20 * S, sent)

    assert ben.merge(21 * S, sent) == (False, [])
    assert ben.take_contributions() == []  # what a robot has learned from another is not its own


def test_evidence_of_robots_multiplies(map_file: Path) -> None:
    robots = [_keeper(map_file, name) for name in ROBOTS]
    for k, robot in enumerate(robots):  # each is too weak to remove it
        robot.apply(10 * S, [observation(0.3, k, THERE)])
        assert _state(robot) is LandmarkState.LIVE
    sent = [robot.take_contributions() for robot in robots]
    for robot in robots:
        changes = robot.merge(11 * S, [one for part in sent for one in part])[1]
        assert "the evidence of ada, ben, cleo together" in changes[-1][1].reason

    assert _shown(robots[0]) == _shown(robots[1]) == _shown(robots[2])
    assert _state(robots[0]) is LandmarkState.RELOCATING


def test_days_apart_and_restarted_robots_agree(map_file: Path) -> None:
    ada, ben = _keeper(map_file, "ada"), _keeper(map_file, "ben")
    _see_it_moved(ada, 10)
    ada.save()
    ada.close()
    ada = _keeper(map_file, "ada")  # with another clock, which is days behind
    ben.apply(5 * 86_400 * S, [observation(0.8, 0)])  # has not seen the move

    def send_all(sender: LandmarkKeeper, receiver: LandmarkKeeper) -> None:
        assert sender.sharing is not None
        receiver.merge(20 * S, list(sender.sharing.record))

    send_all(ben, ada)
    send_all(ada, ben)

    assert _shown(ada) == _shown(ben)
    assert _state(ben) is LandmarkState.LIVE
    assert ben.landmarks[1].position != HERE


def test_lost_robot_takes_back_what_it_has_shared(map_file: Path) -> None:
    ada, ben = _keeper(map_file, "ada"), _keeper(map_file, "ben")
    _see_it_moved(ada, 10, times=1)
    ben.merge(11 * S, ada.take_contributions())
    assert _state(ben) is LandmarkState.RELOCATING

    ada.undo(12 * S, 9 * S)
    ben.merge(13 * S, ada.take_contributions())

    assert _shown(ada) == _shown(ben)
    assert ben.landmarks[1].position == HERE
    assert _state(ben) is LandmarkState.LIVE


def test_what_others_know_is_not_undone(map_file: Path) -> None:
    ada, ben = _keeper(map_file, "ada"), _keeper(map_file, "ben")
    ada.apply(10 * S, [observation(0.3, 0, THERE)])
    _see_it_moved(ben, 10)
    ada.merge(20 * S, ben.take_contributions())

    ada.undo(21 * S, 9 * S)

    assert _shown(ada) == _shown(ben)


def test_repairs_from_before_sharing_are_shared(map_file: Path) -> None:
    alone = LandmarkKeeper(map_file, map_file.with_name("ada.cairn"), 10**18)
    _see_it_moved(alone, 10)
    alone.save()
    alone.close()

    ada, ben = _keeper(map_file, "ada"), _keeper(map_file, "ben")
    assert ada.sharing is not None
    ben.merge(20 * S, list(ada.sharing.record))

    assert ada.landmarks[1].position != HERE
    assert _shown(ada) == _shown(ben)


def test_contributions_about_more_objects_than_fit_are_refused(map_file: Path) -> None:
    ada = LandmarkKeeper(map_file, map_file.with_name("a.cairn"), 10**18, 3, robot="ada")
    ben = _keeper(map_file, "ben")
    for number in (8, 9):
        for step in range(3):
            ben.apply(step * S, [observation(0.9, step, THERE, object_id=number)])

    ada.merge(5 * S, ben.take_contributions())

    assert [one.object_id for one in ada.landmarks] == [6, 7, 8]
    assert ada.refused == (9,)


def test_absurd_contributions_do_not_spoil_the_map(map_file: Path) -> None:
    absurd = Contribution("eve", 7, 1, 0, ORIGINAL, None, removed=False, log_odds=1000.0)
    worse = replace(absurd, robot="mallory", information=PositionInformation(-1e4, 0, 1e15, 1e15))
    mine = replace(absurd, robot="ada", version=2**62, log_odds=0.0)
    for one in (absurd, worse, mine):
        check_contribution(one)
    ada = _keeper(map_file, "ada")
    ada.merge(5 * S, [absurd, worse, mine])

    for step in range(3):
        ada.apply((10 + step) * S, [observation(0.1, step, THERE)])

    assert _state(ada) is LandmarkState.RELOCATING
    for one in ada.take_contributions():
        check_contribution(one)  # others accept it
    ada.save()
    ada.close()
    assert _shown(_keeper(map_file, "ada"))  # can be read


def test_sharing_needs_a_working_copy(map_file: Path) -> None:
    with pytest.raises(CairnError, match="set the parameter working_copy"):
        LandmarkKeeper(map_file, None, 10**18, robot="ada")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"robot": "Ada; DROP"}, "not the name of a robot"),
        ({"object_id": 2**40}, "object"),
        ({"version": 0}, "version"),
        ({"stamp_ns": 2**63}, "stamp"),
        ({"log_odds": float("nan")}, "log-odds"),
        ({"life": Life(5, "ada")}, "no position"),
        ({"life": Life(5, "ada"), "registered": replace(HERE, x=1e9)}, "position"),
        ({"life": Life(5, "ada"), "registered": replace(HERE, xy=1.0)}, "covariance"),
        ({"information": PositionInformation(xx=float("inf"))}, "information"),
    ],
)
def test_contributions_that_no_robot_makes_are_invalid(
    change: dict[str, object], words: str
) -> None:
    good = Contribution("ada", 7, 1, 0, ORIGINAL, None, removed=True, log_odds=0.0)
    check_contribution(good)

    with pytest.raises(ValueError, match=words):
        check_contribution(replace(good, **change))  # type: ignore[arg-type]
