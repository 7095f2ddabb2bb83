"""Taught objects in a map's file: kept exactly, counted, refused when damaged, written in turns."""

import multiprocessing
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn import CairnError
from cairn.vision.map_file import MapFileError, connect, create, writing
from cairn.vision.taught_store import read_taught, remove_taught, taught_number, teach
from tests.cairn.vision.taught_objects import view

pytestmark = pytest.mark.images


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    path = tmp_path / "a.cairn"
    create(path, "a test").close()
    return path


def place(path: Path, object_id: int, name: str) -> None:
    """Put an object into the map."""
    with closing(connect(path)) as connection:
        connection.execute(
            "INSERT INTO objects (object_id, name, reliability, state, evidence_count) "
            "VALUES (?, ?, 0.5, 0, 0)",
            (object_id, name),
        )


def test_a_taught_object_is_read_as_it_was_taught(map_file: Path) -> None:
    taught = [view(1), view(2, 90, 70)]

    object_id = teach(map_file, "cup", taught, (0.08, 0.1))

    (cup,) = read_taught(map_file).objects
    assert (cup.object_id, cup.name, cup.size) == (object_id, "cup", (0.08, 0.1))
    for before, after in zip(taught, cup.views, strict=True):
        assert (after.width, after.height) == (before.width, before.height)
        np.testing.assert_array_equal(after.picture, before.picture)
        for field in ("points", "scales", "angles", "descriptors"):
            kept = getattr(after.features, field)
            np.testing.assert_array_equal(kept, getattr(before.features, field))
            assert kept.dtype == getattr(before.features, field).dtype


def test_teaching_a_name_again_adds_a_view_and_keeps_the_size(map_file: Path) -> None:
    first = teach(map_file, "cup", [view(1)], (0.08, 0.1))

    assert teach(map_file, "cup", [view(2)]) == first

    (cup,) = read_taught(map_file).objects
    assert cup.size == (0.08, 0.1)
    np.testing.assert_array_equal(cup.views[1].picture, view(2).picture)


def test_an_object_of_the_map_keeps_its_number_and_others_get_new_ones(map_file: Path) -> None:
    place(map_file, 6, "poster")
    place(map_file, 9, "clock")

    assert teach(map_file, "poster", [view(1)]) == 6
    assert teach(map_file, "cup", [view(2)]) == 10
    assert teach(map_file, "book", [view(3)]) == 11


@given(steps=st.lists(st.tuples(st.booleans(), st.integers(0, 4)), max_size=12))
@settings(max_examples=15, deadline=None)
def test_no_number_is_used_twice_and_the_count_goes_up(
    tmp_path_factory: pytest.TempPathFactory, steps: list[tuple[bool, int]]
) -> None:
    path = tmp_path_factory.mktemp("m") / "a.cairn"
    create(path, "a test").close()
    known: dict[str, int] = {}
    used: set[int] = set()
    count = 0
    for removing, which in steps:
        name = f"thing {which}"
        if not removing:
            object_id = teach(path, name, [view(1)])
            assert (object_id in used) == (name in known)
            known[name] = object_id
            used.add(object_id)
        elif name in known:
            assert remove_taught(path, name) == known.pop(name)
        else:
            continue
        assert taught_number(path) > count
        count = taught_number(path)
    taught = read_taught(path)
    assert taught.number == count
    assert {o.name: o.object_id for o in taught.objects} == known


def test_a_name_that_several_objects_of_the_map_have_is_refused(map_file: Path) -> None:
    place(map_file, 6, "poster")
    place(map_file, 9, "poster")

    with pytest.raises(CairnError, match="objects 6, 9 of the map are all named 'poster'"):
        teach(map_file, "poster", [view(1)])


def test_a_number_that_was_taught_by_another_name_is_refused(map_file: Path) -> None:
    assert teach(map_file, "cup", [view(1)]) == 1
    place(map_file, 1, "object 1")

    with pytest.raises(CairnError, match="was taught as 'cup'"):
        teach(map_file, "object 1", [view(2)])


@pytest.mark.parametrize("name", ["", " ", " cup", "a\nb", "a\0b", "x" * 101])
def test_a_name_that_cannot_be_shown_is_refused(map_file: Path, name: str) -> None:
    with pytest.raises(CairnError, match="name"):
        teach(map_file, name, [view(1)])
    assert taught_number(map_file) == 0


@pytest.mark.parametrize("size", [(0.0, 1.0), (-1.0, 1.0), (float("nan"), 1.0)])
def test_a_size_that_nothing_has_is_refused(map_file: Path, size: tuple[float, float]) -> None:
    with pytest.raises(CairnError, match=r"cup: its size .* Give width and height in meters"):
        teach(map_file, "cup", [view(1)], size)


def test_what_was_never_taught_cannot_be_removed(map_file: Path) -> None:
    teach(map_file, "cup", [view(1)])

    with pytest.raises(CairnError, match=r"a\.cairn: no object 'mug' was taught.*are: cup"):
        remove_taught(map_file, "mug")


@pytest.mark.parametrize(
    ("damage", "complaint"),
    [
        (
            "UPDATE taught_views SET descriptors = zeroblob(length(descriptors))",
            "it is not as it was written: its checksum differs",
        ),
        ("UPDATE taught_views SET points = x'00'", "its points are 1 bytes instead of"),
        ("UPDATE taught_views SET descriptors = 'text'", "its descriptors are str instead of"),
        ("UPDATE taught_views SET scales = zeroblob(length(scales))", "no number"),
        ("UPDATE taught_views SET width = 20", "outside of its picture"),
        ("UPDATE taught_views SET width = width + 1", "no PNG image of 161 x 120 pixels"),
        ("UPDATE taught_views SET picture = zeroblob(50)", "no PNG image"),
        ("UPDATE taught_views SET height = -1", "a side of -1 pixels"),
        ("UPDATE taught_objects SET width_m = -1, height_m = 1", "not above 0 m"),
        ("UPDATE taught_objects SET width_m = 1", "not above 0 m"),
        ("UPDATE taught_objects SET object_id = -1", "has no view|its number"),
        ("DELETE FROM taught_views", "has no view"),
    ],
)
def test_a_damaged_object_is_told_with_file_name_and_remedy(
    map_file: Path, damage: str, complaint: str
) -> None:
    teach(map_file, "cup", [view(1)])
    with closing(sqlite3.connect(map_file)) as connection, connection:
        connection.execute(damage)

    with pytest.raises(MapFileError, match=complaint) as told:
        read_taught(map_file)

    assert "a.cairn: the taught object 'cup' is damaged" in str(told.value)
    assert "teach it again" in str(told.value)
    remove_taught(map_file, "cup")
    assert read_taught(map_file).objects == ()


def test_while_a_robot_writes_its_map_objects_are_taught_and_seen(map_file: Path) -> None:
    with closing(connect(map_file)) as robot:
        for step in range(5):
            robot.execute(
                "INSERT INTO changes VALUES (?, 0, 3, 'X', 0, 0, 0, 0, 1, 'a test')", (step,)
            )
            teach(map_file, f"thing {step}", [view(step)])
            assert taught_number(map_file) == step + 1
            assert len(read_taught(map_file).objects) == step + 1


def test_who_waits_too_long_for_a_turn_is_told(
    map_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cairn.vision.map_file.LOCK_WAIT_S", 0.05)
    with closing(connect(map_file)) as robot, writing(map_file, robot):
        with pytest.raises(MapFileError, match="Another program writes to it"):
            teach(map_file, "cup", [view(1)])
        assert read_taught(map_file).objects == ()


def test_many_writers_take_turns(map_file: Path) -> None:
    context = multiprocessing.get_context("spawn")
    with context.Pool(3) as pool:
        pool.starmap(_teach_many, [(map_file, k) for k in range(3)])

    taught = read_taught(map_file)
    assert len(taught.objects) == 15
    assert taught.number == 15
    with closing(connect(map_file, read_only=True)) as connection:
        assert connection.execute("SELECT count(*) FROM changes").fetchone()[0] == 15


def _teach_many(path: Path, writer: int) -> None:
    for k in range(5):
        teach(path, f"thing {writer} {k}", [view(k)])
        with closing(connect(path)) as robot, writing(path, robot):
            robot.execute(
                "INSERT INTO changes VALUES (?, 0, 3, 'X', 0, 0, 0, 0, 1, 'a test')",
                (10 * writer + k,),
            )
