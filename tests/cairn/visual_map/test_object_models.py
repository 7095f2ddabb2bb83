"""Tests of object models in the visual map's file."""

import multiprocessing
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn import CairnError
from cairn.visual_map.object_models import add_views, read_models, read_revision, remove_model
from cairn.visual_map.sqlite_file import MapFileError, connect, create, transaction
from tests.cairn.visual_map.views import view
from tests.wording import words_in_order

pytestmark = pytest.mark.images


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    path = tmp_path / "a.cairn"
    create(path, "a test").close()
    return path


def insert_landmark(path: Path, object_id: int, name: str) -> None:
    """Insert a landmark."""
    with closing(connect(path)) as connection:
        connection.execute(
            "INSERT INTO objects (object_id, name, reliability, state, evidence_count) "
            "VALUES (?, ?, 0.5, 0, 0)",
            (object_id, name),
        )


def test_model_is_read_as_it_was_written(map_file: Path) -> None:
    views = [view(1), view(2, 90, 70)]

    object_id = add_views(map_file, "cup", views, (0.08, 0.1))

    (cup,) = read_models(map_file).models
    assert (cup.object_id, cup.name, cup.size) == (object_id, "cup", (0.08, 0.1))
    for before, after in zip(views, cup.views, strict=True):
        assert (after.width, after.height) == (before.width, before.height)
        np.testing.assert_array_equal(after.picture, before.picture)
        for field in ("points", "scales", "angles", "descriptors"):
            kept = getattr(after.features, field)
            np.testing.assert_array_equal(kept, getattr(before.features, field))
            assert kept.dtype == getattr(before.features, field).dtype


def test_adding_views_to_a_known_name_keeps_its_size(map_file: Path) -> None:
    first = add_views(map_file, "cup", [view(1)], (0.08, 0.1))

    assert add_views(map_file, "cup", [view(2)]) == first

    (cup,) = read_models(map_file).models
    assert cup.size == (0.08, 0.1)
    np.testing.assert_array_equal(cup.views[1].picture, view(2).picture)


def test_model_takes_the_identifier_of_its_landmark(map_file: Path) -> None:
    insert_landmark(map_file, 6, "poster")
    insert_landmark(map_file, 9, "clock")

    assert add_views(map_file, "poster", [view(1)]) == 6
    assert add_views(map_file, "cup", [view(2)]) == 10
    assert add_views(map_file, "book", [view(3)]) == 11


@given(steps=st.lists(st.tuples(st.booleans(), st.integers(0, 4)), max_size=12))
@settings(max_examples=15, deadline=None)
def test_identifiers_are_never_reused_and_the_revision_increases(
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
            object_id = add_views(path, name, [view(1)])
            assert (object_id in used) == (name in known)
            known[name] = object_id
            used.add(object_id)
        elif name in known:
            assert remove_model(path, name) == known.pop(name)
        else:
            continue
        assert read_revision(path) > count
        count = read_revision(path)
    stored = read_models(path)
    assert stored.revision == count
    assert {o.name: o.object_id for o in stored.models} == known


def test_ambiguous_name_is_rejected(map_file: Path) -> None:
    insert_landmark(map_file, 6, "poster")
    insert_landmark(map_file, 9, "poster")

    with pytest.raises(CairnError, match=words_in_order("6, 9", "'poster'")):
        add_views(map_file, "poster", [view(1)])


def test_identifier_with_another_model_name_is_rejected(map_file: Path) -> None:
    assert add_views(map_file, "cup", [view(1)]) == 1
    insert_landmark(map_file, 1, "object 1")

    with pytest.raises(CairnError, match="its model is 'cup'"):
        add_views(map_file, "object 1", [view(2)])


@pytest.mark.parametrize("name", ["", " ", " cup", "a\nb", "a\0b", "x" * 101])
def test_invalid_name_is_rejected(map_file: Path, name: str) -> None:
    with pytest.raises(CairnError, match="name"):
        add_views(map_file, name, [view(1)])
    assert read_revision(map_file) == 0


@pytest.mark.parametrize("size", [(0.0, 1.0), (-1.0, 1.0), (float("nan"), 1.0)])
def test_invalid_size_is_rejected(map_file: Path, size: tuple[float, float]) -> None:
    with pytest.raises(CairnError, match=words_in_order("cup", "size", "width and height")):
        add_views(map_file, "cup", [view(1)], size)


def test_removing_an_unknown_model_lists_known_ones(map_file: Path) -> None:
    add_views(map_file, "cup", [view(1)])

    with pytest.raises(CairnError, match=r"a\.cairn: object model 'mug' .*: cup"):
        remove_model(map_file, "mug")


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (
            "UPDATE taught_views SET descriptors = zeroblob(length(descriptors))",
            "the checksum differs",
        ),
        ("UPDATE taught_views SET points = x'00'", "its points are 1 bytes instead of"),
        ("UPDATE taught_views SET descriptors = 'text'", "its descriptors are str instead of"),
        ("UPDATE taught_views SET scales = zeroblob(length(scales))", "not a number"),
        ("UPDATE taught_views SET width = 20", "outside of its picture"),
        ("UPDATE taught_views SET width = width + 1", "not a PNG image of 161 x 120 pixels"),
        ("UPDATE taught_views SET picture = zeroblob(50)", "not a PNG image"),
        ("UPDATE taught_views SET height = -1", "width or height -1"),
        ("UPDATE taught_objects SET width_m = -1, height_m = 1", "not above 0 m"),
        ("UPDATE taught_objects SET width_m = 1", "not above 0 m"),
        ("UPDATE taught_objects SET object_id = -1", "has no view|its identifier"),
        ("DELETE FROM taught_views", "has no view"),
    ],
)
def test_damaged_model_is_reported_with_file_name_and_remedy(
    map_file: Path, damage: str, message: str
) -> None:
    add_views(map_file, "cup", [view(1)])
    with closing(sqlite3.connect(map_file)) as connection, connection:
        connection.execute(damage)

    with pytest.raises(MapFileError, match=message) as raised:
        read_models(map_file)

    assert "a.cairn: the object model 'cup' is damaged" in str(raised.value)
    assert "teach it again" in str(raised.value)
    remove_model(map_file, "cup")
    assert read_models(map_file).models == ()


def test_models_are_added_while_the_map_builder_writes(map_file: Path) -> None:
    with closing(connect(map_file)) as robot:
        for step in range(5):
            robot.execute(
                "INSERT INTO changes VALUES (?, 0, 3, 'X', 0, 0, 0, 0, 1, 'a test')", (step,)
            )
            add_views(map_file, f"thing {step}", [view(step)])
            assert read_revision(map_file) == step + 1
            assert len(read_models(map_file).models) == step + 1


def test_writer_that_waits_too_long_fails(map_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cairn.visual_map.sqlite_file.LOCK_WAIT_S", 0.05)
    with closing(connect(map_file)) as robot, transaction(map_file, robot):
        with pytest.raises(MapFileError, match="Another program is writing to it"):
            add_views(map_file, "cup", [view(1)])
        assert read_models(map_file).models == ()


@pytest.mark.accuracy
def test_concurrent_writers_all_succeed(map_file: Path) -> None:
    context = multiprocessing.get_context("spawn")
    with context.Pool(3) as pool:
        pool.starmap(_add_many, [(map_file, k) for k in range(3)])

    stored = read_models(map_file)
    assert len(stored.models) == 15
    assert stored.revision == 15
    with closing(connect(map_file, read_only=True)) as connection:
        assert connection.execute("SELECT count(*) FROM changes").fetchone()[0] == 15


def _add_many(path: Path, writer: int) -> None:
    for k in range(5):
        add_views(path, f"thing {writer} {k}", [view(k)])
        with closing(connect(path)) as robot, transaction(path, robot):
            robot.execute(
                "INSERT INTO changes VALUES (?, 0, 3, 'X', 0, 0, 0, 0, 1, 'a test')",
                (10 * writer + k,),
            )
