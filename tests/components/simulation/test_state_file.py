"""A world whose process was killed goes on where it was."""

from pathlib import Path
from unittest.mock import patch

import pytest

from cairn.components.simulation.state_file import StateFile
from cairn.components.simulation.world import World
from tests.components.simulation.worlds import world_of

TABLE = {"name": "table", "x": 1.5, "y": 2.0, "size": [0.8, 0.8]}


def world() -> World:
    return world_of(
        furniture=[TABLE, {**TABLE, "name": "crate", "x": 4.6}],
        objects=[{"id": 1, "x": 0.0, "y": 3.0}],
        people=[{"name": "ada", "waypoints": [[1.0, 3.4], [5.0, 3.4]], "pause": 3.0}],
        events=[{"at": 1, "remove": "crate"}, {"at": 9, "remove": "table"}],
    )


@pytest.mark.parametrize("moved", [True, False])
def test_it_goes_on_where_it_was(tmp_path: Path, moved: bool) -> None:
    file = StateFile(tmp_path / "world.jsonl")
    before = world()
    file.keep(before, 0.5)
    for number in range(200):
        before.drive(0.02, 0.2, 0.1)
        before.walk(0.02)
        before.happen(number * 0.02)
        file.keep(before, number * 0.02)
    if moved:
        before.move("object_1", (6.0, 1.0, 3.1))
    before.walkers[0].detour = [(2.0, 3.0, 4.0)]
    file.keep(before, 4.0)

    after = world()
    kept = file.kept()
    assert kept is not None
    kept.put_into(after)

    assert after.robot == before.robot
    assert after.walkers == before.walkers
    assert after.scene.furniture == before.scene.furniture
    assert after.scene.objects == before.scene.objects
    assert after.happen(8.0) == []
    assert [one.told for one in after.happen(9.0)] == ["table is taken away"]


@pytest.mark.parametrize("text", [None, "", "\n", "{}\n{}\n", '{"elapsed_s": 1', "\xff"])
def test_what_cannot_be_read_is_no_state(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "world.jsonl"
    if text is not None:
        path.write_text(text, encoding="latin-1")

    assert StateFile(path).kept() is None


def test_a_disk_that_takes_nothing_is_the_callers_matter(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file"):
        StateFile(tmp_path / "gone" / "world.jsonl").keep(world(), 0.0)


def test_a_line_that_was_cut_short_does_not_count(tmp_path: Path) -> None:
    path = tmp_path / "world.jsonl"
    file = StateFile(path)
    for elapsed_s in (1.0, 2.0):
        file.keep(world(), elapsed_s)
    path.write_bytes(path.read_bytes()[:-5])

    kept = file.kept()

    assert kept is not None
    assert kept.elapsed_s == 1.0


def test_it_does_not_grow_without_end_and_always_holds_the_newest_state(tmp_path: Path) -> None:
    path = tmp_path / "world.jsonl"
    file = StateFile(path)
    for number in range(2000):
        file.keep(world(), float(number))

    assert path.stat().st_size < 300_000
    kept = file.kept()
    assert kept is not None
    assert kept.elapsed_s == 1999.0


def test_after_a_disk_that_was_full_nothing_of_half_a_line_is_left(tmp_path: Path) -> None:
    path = tmp_path / "world.jsonl"
    file = StateFile(path)
    file.keep(world(), 1.0)
    with path.open("ab") as half, patch.object(Path, "open", side_effect=OSError("no space left")):
        half.write(b'{"elapsed_s":2')
        with pytest.raises(OSError, match="no space"):
            file.keep(world(), 2.0)
    file.keep(world(), 3.0)

    kept = file.kept()

    assert kept is not None
    assert kept.elapsed_s == 3.0
