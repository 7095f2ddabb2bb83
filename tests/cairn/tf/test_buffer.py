"""The transform buffer: lookups, errors, and bounds, as tf2 has them."""

import logging
import math
import threading
import tracemalloc
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from cairn import CairnError
from cairn.schemas.geometry_msgs import Quaternion, TransformStamped, Vector3
from cairn.schemas.geometry_msgs import Transform as TransformMessage
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage
from cairn.tf import (
    Buffer,
    BufferFullError,
    ConnectivityError,
    ExtrapolationError,
    InvalidArgumentError,
    Transform,
    TransformError,
    UnknownFrameError,
)
from tests.wording import assert_words, words_in_order

from .frames import along_x, assert_same, at, reference_matrix, stamped, transforms

CHAIN = ("map", "odom", "base_link", "mast", "camera")


def buffer_of(*messages: TransformStamped, static: bool = False, **settings: object) -> Buffer:
    buffer = Buffer(**settings)  # type: ignore[arg-type]
    for message in messages:
        buffer.set_transform(message, static=static)
    return buffer


@pytest.fixture
def problems() -> list[str]:
    return []


# --- Lookups ------------------------------------------------------------------------------------


@st.composite
def trees(draw: st.DrawFn) -> tuple[Buffer, dict[str, np.ndarray]]:
    """A tree of static frames, with the pose of each in the root as a matrix."""
    edges = draw(st.lists(transforms, min_size=1, max_size=6))
    poses = {"f0": np.eye(4)}
    buffer = Buffer()
    for number, transform in enumerate(edges, 1):
        parent = f"f{draw(st.integers(0, number - 1))}"
        poses[f"f{number}"] = poses[parent] @ reference_matrix(transform)
        buffer.set_transform(stamped(parent, f"f{number}", transform=transform), static=True)
    return buffer, poses


@given(trees(), st.data())
def test_lookup_is_that_of_the_poses_in_the_root(
    tree: tuple[Buffer, dict[str, np.ndarray]], data: st.DataObject
) -> None:
    buffer, poses = tree
    a, b, c = (data.draw(st.sampled_from(sorted(poses))) for _ in range(3))

    found = buffer.lookup(a, b)

    wanted = np.linalg.inv(poses[a]) @ poses[b]
    np.testing.assert_allclose(found.matrix(), wanted, atol=1e-8)
    assert_same(found @ buffer.lookup(b, c), buffer.lookup(a, c))
    assert_same(buffer.lookup(b, a), found.inverse())
    assert_same(buffer.lookup_full(a, None, b, None, c), found)


@given(
    st.lists(st.integers(0, 9_000), min_size=2, max_size=20, unique=True),
    st.data(),
)
def test_transform_between_two_stamps_is_interpolated_whatever_the_order_of_arrival(
    milliseconds: list[int], data: st.DataObject
) -> None:
    edges = {stamp: data.draw(transforms) for stamp in milliseconds}
    buffer = buffer_of(*(stamped("odom", "base", ms / 1000, one) for ms, one in edges.items()))
    first, last = min(edges), max(edges)
    wanted_ms = data.draw(st.integers(first, last))
    before = max(ms for ms in edges if ms <= wanted_ms)
    after = min(ms for ms in edges if ms >= wanted_ms)

    found = buffer.lookup("odom", "base", wanted_ms * 1_000_000)

    fraction = (wanted_ms - before) / (after - before) if after > before else 0.0
    assert_same(found, edges[before].interpolate(edges[after], fraction))
    low = np.minimum(edges[before].translation, edges[after].translation) - 1e-9
    high = np.maximum(edges[before].translation, edges[after].translation) + 1e-9
    assert ((low <= found.translation) & (found.translation <= high)).all()


@given(st.data())
def test_lookup_in_a_moving_tree_is_that_of_the_interpolated_edges(data: st.DataObject) -> None:
    buffer = Buffer()
    parents: dict[str, str] = {}
    for number in range(1, data.draw(st.integers(2, 5))):
        child, parent = f"f{number}", f"f{data.draw(st.integers(0, number - 1))}"
        parents[child] = parent
        for stamp in sorted(data.draw(st.sets(st.integers(0, 20), min_size=2, max_size=4))):
            buffer.set_transform(stamped(parent, child, stamp / 10, data.draw(transforms)))
    source, target = (data.draw(st.sampled_from(["f0", *parents])) for _ in range(2))
    time_ns = at(data.draw(st.integers(0, 200)) / 100)

    def chain_of(frame: str) -> list[str]:
        chain = [frame]
        while chain[-1] in parents:
            chain.append(parents[chain[-1]])
        return chain

    needed = set(chain_of(source)) ^ set(chain_of(target))  # below the common frame
    known = buffer.frames()
    has_all = all(
        (known[one].oldest_ns or 0) <= time_ns <= (known[one].newest_ns or 0) for one in needed
    )
    assert buffer.can_transform(target, source, time_ns) == has_all
    if not has_all:
        with pytest.raises(ExtrapolationError) as caught:
            buffer.lookup(target, source, time_ns)
        assert caught.value.child in needed
        return
    poses = [np.eye(4), np.eye(4)]
    for index, frame in enumerate((source, target)):
        for one in chain_of(frame):
            if one in needed:
                edge = buffer.lookup(parents[one], one, time_ns)
                poses[index] = reference_matrix(edge) @ poses[index]
    wanted = np.linalg.inv(poses[1]) @ poses[0]
    np.testing.assert_allclose(buffer.lookup(target, source, time_ns).matrix(), wanted, atol=1e-8)


def test_target_is_the_frame_of_the_result() -> None:
    buffer = buffer_of(stamped("base_link", "laser", 1.0, along_x(0.2)))

    assert buffer.lookup("base_link", "laser").apply([1.0, 0.0, 0.0])[0] == pytest.approx(1.2)
    assert buffer.lookup("laser", "base_link").apply([1.2, 0.0, 0.0])[0] == pytest.approx(1.0)


def test_newest_common_time_is_that_of_the_slowest_frame_on_the_path() -> None:
    buffer = buffer_of(
        stamped("odom", "base", 1.0, along_x(1.0)),
        stamped("odom", "base", 3.0, along_x(3.0)),
        stamped("map", "odom", 1.5),
        stamped("map", "odom", 2.0, along_x(10.0)),
    )
    buffer.set_transform(stamped("base", "laser", 0.0), static=True)

    assert buffer.newest_common_time("map", "laser") == at(2.0)
    assert buffer.lookup("map", "laser").translation == pytest.approx((12.0, 0.0, 0.0))
    assert buffer.newest_common_time("odom", "laser") == at(3.0)  # map is not on the path
    assert buffer.lookup("odom", "laser").translation == pytest.approx((3.0, 0.0, 0.0))


def test_static_transform_holds_at_all_times() -> None:
    buffer = buffer_of(stamped("base", "laser", 50.0, along_x(1.0)), static=True)

    for seconds in (0.0, 50.0, 1e6):
        assert buffer.lookup("base", "laser", at(seconds)).translation[0] == 1.0
    assert buffer.newest_common_time("base", "laser") is None
    assert buffer.lookup("base", "laser").translation[0] == 1.0


def test_frame_above_the_common_one_needs_no_transform_at_that_time() -> None:
    buffer = buffer_of(stamped("odom", "base", 5.0), stamped("map", "odom", 1.0))
    buffer.set_transform(stamped("base", "laser", 0.0, along_x(1.0)), static=True)
    buffer.set_transform(stamped("base", "camera", 0.0, along_x(3.0)), static=True)

    assert buffer.lookup("camera", "laser", at(99.0)).translation[0] == -2.0


def test_frame_in_itself_is_the_identity_at_any_time() -> None:
    buffer = buffer_of(stamped("odom", "base", 5.0, along_x(1.0)))

    assert buffer.lookup("base", "base", at(77.0)) == Transform()
    assert buffer.lookup("odom", "odom") == Transform()


def test_transform_of_the_same_stamp_is_replaced() -> None:
    buffer = buffer_of(
        stamped("odom", "base", 1.0, along_x(1.0)),
        stamped("odom", "base", 2.0, along_x(2.0)),
        stamped("odom", "base", 1.0, along_x(7.0)),
    )

    assert buffer.lookup("odom", "base", at(1.0)).translation[0] == 7.0
    assert buffer.frames()["base"].transforms == 2


def test_between_two_times_by_a_fixed_frame() -> None:
    buffer = buffer_of(
        stamped("odom", "base", 1.0, along_x(1.0)), stamped("odom", "base", 3.0, along_x(5.0))
    )

    moved = buffer.lookup_full("base", at(3.0), "base", at(1.0), "odom")

    assert moved.translation[0] == pytest.approx(-4.0)  # what was here is 4 m behind now
    assert buffer.lookup_full("base", None, "base", at(2.0), "odom").translation[0] == -2.0


def test_stamp_of_zero_is_a_time_and_not_the_newest() -> None:
    buffer = buffer_of(
        stamped("odom", "base", 0.0, along_x(1.0)), stamped("odom", "base", 1.0, along_x(2.0))
    )

    assert buffer.lookup("odom", "base", 0).translation[0] == 1.0
    assert buffer.lookup("odom", "base", np.int64(0)).translation[0] == 1.0  # type: ignore[arg-type]


def test_component_adds_messages_as_they_arrive() -> None:
    buffer = Buffer()

    buffer.add(TFMessage(transforms=(stamped("map", "odom", 1.0),)), static=False)
    both = (stamped("base", "laser"), stamped("base", "camera", transform=along_x(1.0)))
    buffer.add(TFMessage(transforms=both), static=True)
    buffer.add(TFMessage(transforms=(stamped("odom", "base", 1.0),)), static=False)

    assert buffer.lookup("map", "camera", at(1.0)).translation[0] == 1.0
    assert [one.name for one in buffer.frames().values() if one.is_static] == ["camera", "laser"]


# --- Errors -------------------------------------------------------------------------------------


def chain(seconds: float = 10.0) -> Buffer:
    return buffer_of(*(stamped(a, b, seconds) for a, b in pairwise(CHAIN)))


def test_unknown_frame_is_reported_with_the_known_ones_and_a_similar_one() -> None:
    with pytest.raises(UnknownFrameError) as caught:
        chain().lookup("map", "base_lnk")

    assert_words(
        str(caught.value), "base_lnk", "did you mean base_link", "base_link, camera", "odom"
    )
    with pytest.raises(UnknownFrameError, match=words_in_order("no frame map", "none")):
        Buffer().lookup("map", "base_link")
    with pytest.raises(UnknownFrameError, match="no frame moon"):
        chain().lookup("moon", "moon")


def test_only_some_of_many_known_frames_are_listed() -> None:
    buffer = buffer_of(*(stamped("map", f"f{number:04}") for number in range(1000)))

    with pytest.raises(UnknownFrameError, match="981 more") as caught:
        buffer.lookup("map", "?")

    assert len(str(caught.value)) < 400


def test_frames_of_two_trees_are_reported_with_their_roots() -> None:
    buffer = chain()
    buffer.set_transform(stamped("dock", "charger", 10.0))

    for time_ns in (None, at(10.0), at(99.0)):
        with pytest.raises(
            ConnectivityError, match=words_in_order("camera", "charger", "map", "dock")
        ):
            buffer.lookup("charger", "camera", time_ns)
        assert not buffer.can_transform("charger", "camera", time_ns)


def test_time_after_the_newest_transform_is_reported_with_the_edge() -> None:
    buffer = chain(10.0)
    buffer.set_transform(stamped("odom", "base_link", 9.0))
    for pair in (("map", "odom"), ("base_link", "mast"), ("mast", "camera")):
        buffer.set_transform(stamped(*pair, 12.0))

    with pytest.raises(ExtrapolationError) as caught:
        buffer.lookup("map", "camera", at(11.5))

    error = caught.value
    assert_words(
        str(error), "odom -> base_link", "11.500000000 s", "newest", "10.000000000 s",
        "1.500000000 s before", "earlier time",
    )  # fmt: skip
    assert (error.parent, error.child, error.requested_ns) == ("odom", "base_link", at(11.5))
    assert (error.oldest_ns, error.newest_ns) == (at(9.0), at(10.0))
    assert not buffer.can_transform("map", "camera", at(11.5))
    assert buffer.can_transform("map", "camera", at(10.0))


def test_time_before_the_oldest_transform_is_reported_with_the_edge() -> None:
    with pytest.raises(ExtrapolationError) as caught:
        buffer_of(stamped("a", "b", 10.0), stamped("a", "b", 11.0)).lookup("b", "a", at(9.9))

    assert_words(
        str(caught.value), "a -> b", "9.900000000 s", "oldest", "10.000000000 s", "0.100000000 s",
        "cache_s",
    )  # fmt: skip


def test_named_edge_is_on_the_path_although_one_above_lacks_the_time_too() -> None:
    buffer = buffer_of(stamped("map", "odom", 1.0), stamped("odom", "arm", 2.0))
    buffer.set_transform(stamped("odom", "laser"), static=True)

    with pytest.raises(ExtrapolationError, match="odom -> arm"):
        buffer.lookup("arm", "laser", at(5.0))


def test_single_transform_holds_only_at_its_stamp() -> None:
    buffer = buffer_of(stamped("a", "b", 10.0))

    assert buffer.can_transform("a", "b", at(10.0))
    assert not buffer.can_transform("a", "b", at(10.0) + 1)
    assert not buffer.can_transform("a", "b", at(10.0) - 1)


@pytest.mark.parametrize(("target", "source"), [("", "b"), ("a", ""), ("/a", "b"), ("a", "/b")])
def test_invalid_frame_name_of_a_lookup_is_rejected(target: str, source: str) -> None:
    buffer = buffer_of(stamped("a", "b", 1.0))

    for call in (buffer.lookup, buffer.can_transform, buffer.newest_common_time):
        with pytest.raises(InvalidArgumentError, match=words_in_order("empty", "slash")):
            call(target, source)


def test_time_in_seconds_is_rejected() -> None:
    with pytest.raises(InvalidArgumentError, match=words_in_order("1.5", "nanoseconds")):
        buffer_of(stamped("a", "b", 1.0)).lookup("a", "b", 1.5)  # type: ignore[arg-type]


def test_leading_slash_of_a_transform_is_removed_as_in_tf2() -> None:
    buffer = buffer_of(stamped("/odom", "/base", 1.0))

    assert sorted(buffer.frames()) == ["base", "odom"]


@pytest.mark.parametrize(
    ("parent", "child", "words"),
    [
        ("", "b", ("header.frame_id", "0 characters")),
        ("a", "", ("child_frame_id", "0 characters")),
        ("/", "b", ("header.frame_id", "0 characters")),
        ("a", "b" * 256, ("child_frame_id", "256 characters", "255")),
        ("a", "a", ("'a'", "its own parent")),
        ("a", "/a", ("'a'", "its own parent")),
    ],
)
def test_invalid_frame_name_of_a_transform_is_rejected(
    parent: str, child: str, words: tuple[str, ...]
) -> None:
    buffer = Buffer()

    with pytest.raises(InvalidArgumentError, match=words_in_order(*words)):
        buffer.set_transform(stamped(parent, child, 1.0))
    assert buffer.frames() == {}


def with_rotation(*rotation: float) -> TransformStamped:
    x, y, z, w = rotation
    turned = TransformMessage(rotation=Quaternion(x=x, y=y, z=z, w=w), translation=Vector3())
    return TransformStamped(header=Header(frame_id="a"), child_frame_id="b", transform=turned)


def test_quaternion_that_is_not_normalized_is_rejected() -> None:
    buffer = Buffer()

    with pytest.raises(InvalidArgumentError, match=words_in_order("'a' -> 'b'", "not normalized")):
        buffer.set_transform(with_rotation(0.0, 0.0, 0.0, 0.0))
    assert buffer.frames() == {}


def test_number_that_is_not_finite_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    # Messages from the bus are finite; an object of a user's own class may not be.
    class Moved:
        x, y, z = 0.0, math.nan, 0.0

    message = stamped("a", "b")
    hostile = type("Hostile", (), {"translation": Moved, "rotation": message.transform.rotation})
    fake = type("Fake", (), {"header": message.header, "child_frame_id": "b", "transform": hostile})

    with pytest.raises(InvalidArgumentError, match=words_in_order("'a' -> 'b'", "not finite")):
        Buffer().set_transform(fake)  # type: ignore[arg-type]


def test_every_error_of_the_buffer_is_one_of_cairn() -> None:
    for kind in (UnknownFrameError, ConnectivityError, ExtrapolationError, InvalidArgumentError,
                 BufferFullError):  # fmt: skip
        assert issubclass(kind, TransformError)
    assert issubclass(TransformError, CairnError)


@pytest.mark.parametrize("settings", [{"cache_s": 0.0}, {"cache_s": math.nan}, {"max_frames": 0}])
def test_limit_that_is_not_positive_is_rejected(settings: dict[str, float]) -> None:
    with pytest.raises(InvalidArgumentError, match="positive"):
        Buffer(**settings)  # type: ignore[arg-type]


# --- Messages with invalid transforms, contradictions, time set back ----------------------------


def test_invalid_transform_of_a_message_is_counted_and_reported_once(problems: list[str]) -> None:
    buffer = Buffer(on_problem=problems.append)
    message = TFMessage(
        transforms=(with_rotation(0.0, 0.0, 0.0, 9.0), stamped("a", "c", 1.0), stamped("", "d"))
    )

    for _ in range(3):
        buffer.add(message, static=False)

    assert buffer.rejected == 6
    assert sorted(buffer.frames()) == ["a", "c"]
    assert [("'b'" in text, "'d'" in text) for text in problems] == [(True, False), (False, True)]


def test_without_a_callback_problems_are_logged(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        Buffer().add(TFMessage(transforms=(stamped("a", "a"),)), static=True)

    assert_words(caplog.text, "rejected transform", "its own parent")


def test_second_parent_is_reported_once_and_the_newest_transform_counts(
    problems: list[str],
) -> None:
    buffer = Buffer(on_problem=problems.append)
    for seconds in (1.0, 2.0, 3.0):
        buffer.set_transform(stamped("odom", "base", seconds, along_x(1.0)), publisher="/r/wheels")
        other = stamped("map", "base", seconds + 0.5, along_x(5.0))
        buffer.set_transform(other, publisher="/r/localizer")

    assert len(problems) == 1
    assert_words(problems[0], "base", "odom (from /r/wheels)", "map (from /r/localizer)")
    assert buffer.lookup("map", "base").translation[0] == 5.0
    assert buffer.frames()["base"].parent == "map"
    # The older of two transforms with different parents holds until the newer one, as in tf2.
    assert buffer.lookup("odom", "base", at(2.25)).translation[0] == 1.0
    with pytest.raises(ConnectivityError):
        buffer.lookup("map", "base", at(2.25))


def test_second_publisher_is_reported_once(problems: list[str]) -> None:
    buffer = Buffer(on_problem=problems.append)
    for publisher in ("", "/r/wheels", "/r/wheels", "", "/r/wheels"):
        buffer.set_transform(stamped("odom", "base", 1.0), publisher=publisher)
    assert problems == []

    for publisher in ("/r/imu", "/r/wheels", "/r/imu"):
        buffer.set_transform(stamped("odom", "base", 1.0), publisher=publisher)

    assert len(problems) == 1
    assert_words(problems[0], "base: ", "published by /r/wheels", "now by /r/imu", "one component")


def test_transform_that_becomes_static_or_changing_is_reported_once(problems: list[str]) -> None:
    buffer = Buffer(on_problem=problems.append)
    for _ in range(2):
        buffer.set_transform(stamped("base", "laser", 1.0, along_x(1.0)), static=True)
        buffer.set_transform(stamped("base", "laser", 2.0, along_x(2.0)))

    assert len(problems) == 1
    assert_words(problems[0], "laser", "static", "changing", "not on both")
    assert buffer.frames()["laser"].transforms == 1
    assert not buffer.can_transform("base", "laser", at(1.0))
    buffer.set_transform(stamped("base", "laser", 3.0, along_x(3.0)), static=True)
    assert buffer.lookup("base", "laser", at(1.0)).translation[0] == 3.0


def test_loop_of_parents_is_an_error_and_not_endless() -> None:
    buffer = buffer_of(stamped("a", "b", 1.0), stamped("b", "c", 1.0), stamped("c", "a", 1.0))
    buffer.set_transform(stamped("x", "y", 1.0))

    for target, source in (("x", "b"), ("b", "x")):
        with pytest.raises(ConnectivityError, match=words_in_order("form a loop", "wrong parent")):
            buffer.lookup(target, source)
        assert not buffer.can_transform(target, source, at(1.0))
    with pytest.raises(ConnectivityError, match=words_in_order("b, a, c", "form a loop")):
        buffer.lookup("x", "b")


def test_time_set_back_is_reported_and_clear_starts_again(problems: list[str]) -> None:
    buffer = Buffer(on_problem=problems.append)
    buffer.set_transform(stamped("base", "laser", transform=along_x(0.5)), static=True)
    buffer.set_transform(stamped("odom", "base", 1000.0, along_x(9.0)))
    for seconds in (1.0, 1.1):
        buffer.set_transform(stamped("odom", "base", seconds, along_x(1.0)))

    assert buffer.rejected == 2
    assert len(problems) == 1
    assert_words(problems[0], "base", "1.000000000 s", "1000.000000000 s", "clear the buffer")
    assert buffer.lookup("odom", "base").translation[0] == 9.0

    buffer.clear()
    assert sorted(buffer.frames()) == ["base", "laser"]
    assert buffer.lookup("base", "laser").translation[0] == 0.5
    with pytest.raises(UnknownFrameError, match="odom"):
        buffer.lookup("odom", "base")
    buffer.set_transform(stamped("odom", "base", 1.0, along_x(1.0)))
    assert buffer.lookup("odom", "laser", at(1.0)).translation[0] == 1.5


# --- The tree -----------------------------------------------------------------------------------


def test_frames_describe_the_tree() -> None:
    buffer = Buffer()
    for number in range(11):
        message = stamped("odom", "base", 5.0 + 0.02 * number)
        buffer.set_transform(message, publisher="/r/wheels")
    buffer.set_transform(stamped("base", "laser"), static=True)

    frames = buffer.frames()

    assert list(frames) == ["base", "laser", "odom"]
    base = frames["base"]
    assert (base.parent, base.publisher, base.is_static) == ("odom", "/r/wheels", False)
    assert (base.transforms, base.oldest_ns, base.newest_ns) == (11, at(5.0), at(5.2))
    assert base.rate_hz == pytest.approx(50.0)
    assert (frames["odom"].parent, frames["odom"].transforms) == (None, 0)
    assert frames["odom"].rate_hz is None
    laser = frames["laser"]
    assert (laser.is_static, laser.newest_ns, laser.rate_hz) == (True, None, None)


# --- Bounds -------------------------------------------------------------------------------------


def test_transforms_older_than_the_cache_are_dropped() -> None:
    buffer = buffer_of(*(stamped("a", "b", float(second)) for second in range(31)), cache_s=10.0)

    info = buffer.frames()["b"]
    assert (info.oldest_ns, info.newest_ns, info.transforms) == (at(20.0), at(30.0), 11)
    assert not buffer.can_transform("a", "b", at(19.9))


def test_transforms_of_a_frame_have_a_limit() -> None:
    many = (stamped("a", "b", 0.001 * number) for number in range(300))
    info = buffer_of(*many, max_transforms_of_frame=100).frames()["b"]

    assert (info.transforms, info.newest_ns) == (100, at(0.299))


@given(st.lists(st.tuples(st.integers(1, 8), st.integers(0, 500)), max_size=200))
def test_transforms_of_all_frames_have_a_limit(arrivals: list[tuple[int, int]]) -> None:
    assume(arrivals)
    buffer = Buffer(max_transforms=20)
    for frame, milliseconds in arrivals:
        buffer.set_transform(stamped("a", f"f{frame}", milliseconds / 1000))

    frames = buffer.frames()
    assert sum(one.transforms for one in frames.values()) <= 20
    newest = {f"f{frame}" for frame, _ in arrivals}
    assert all(frames[name].transforms for name in newest)  # none is lost entirely


def test_frame_with_few_transforms_keeps_them_beside_one_with_many() -> None:
    buffer = buffer_of(*(stamped("a", "fast", 0.001 * n) for n in range(100)), max_transforms=50)
    for number in range(8):
        buffer.set_transform(stamped("a", "slow", 0.01 * number))

    frames = buffer.frames()
    assert frames["slow"].transforms == 8
    assert frames["fast"].transforms <= 42
    assert frames["fast"].newest_ns == at(0.099)


def test_hostile_frames_do_not_fill_the_memory(problems: list[str]) -> None:
    buffer = Buffer(on_problem=problems.append)
    buffer.set_transform(stamped("odom", "base", 1.0, along_x(1.0)))
    message = stamped("a", "b", 1.0)
    header, transform = message.header, message.transform
    tracemalloc.start()
    try:
        for number in range(15_000):
            name = f"{number:0255}"
            one = TransformStamped(header=header, child_frame_id=name, transform=transform)
            buffer.add(TFMessage(transforms=(one,)), static=False)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert len(buffer.frames()) == 4096
    assert buffer.rejected == 15_000 - (4096 - 3)
    assert peak < 5e6  # all 15,000 frames would take 12 MB
    assert len(problems) == 1
    assert_words(problems[0], "4096 frames", "invents frame names", "max_frames")
    buffer.set_transform(stamped("odom", "base", 2.0, along_x(2.0)))  # known frames continue
    assert buffer.lookup("odom", "base").translation[0] == 2.0


def test_new_frame_of_a_full_buffer_is_rejected_whole() -> None:
    buffer = buffer_of(stamped("a", "b", 1.0), max_frames=3)

    with pytest.raises(BufferFullError):
        buffer.set_transform(stamped("c", "d", 1.0))
    assert sorted(buffer.frames()) == ["a", "b"]
    buffer.set_transform(stamped("b", "c", 1.0))
    assert buffer.can_transform("a", "c")


def test_number_of_reports_has_a_limit(problems: list[str]) -> None:
    buffer = Buffer(on_problem=problems.append)
    for number in range(1500):
        message = stamped(f"f{number}", f"f{number}")
        buffer.add(TFMessage(transforms=(message,)), static=False)

    assert len(problems) == 1000
    assert buffer.rejected == 1500


def test_threads_may_add_and_look_up_at_once() -> None:
    buffer = buffer_of(stamped("odom", "base", 0.0), max_transforms=50)
    failed: list[BaseException] = []
    ended = threading.Event()

    def add() -> None:
        try:
            for number in range(3000):
                buffer.set_transform(stamped("odom", "base", 0.001 * number, along_x(number)))
        except BaseException as error:
            failed.append(error)
        ended.set()

    thread = threading.Thread(target=add)
    thread.start()
    while not ended.is_set():
        newest = buffer.newest_common_time("odom", "base")
        assert newest is not None
        assert buffer.lookup("odom", "base").translation[0] >= newest / 1e6 - 1e-6
    thread.join()

    assert failed == []
    assert buffer.lookup("odom", "base").translation[0] == 2999.0
