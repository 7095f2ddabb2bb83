"""A world whose process was killed continues from its saved state."""

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
def test_world_continues_from_its_saved_state(tmp_path: Path, moved: bool) -> None:
    file = StateFile(tmp_path / "world.jsonl")
    before = world()
    file.save(before, 0.5)
    for number in range(200):
        before.drive(0.02, 0.2, 0.1)
        before.move_people(0.02)
        before.run_due_events(number * 0.02)
        file.save(before, number * 0.02)
    if moved:
        before.move("object_1", (6.0, 1.0, 3.1))
    before.walkers[0].detour = [(2.0, 3.0, 4.0)]
    file.save(before, 4.0)

    after = world()
    kept = file.load()
    assert kept is not None
    kept.restore(after)

    assert after.robot == before.robot
    assert after.walkers == before.walkers
    assert after.layout.furniture == before.layout.furniture
    assert after.layout.objects == before.layout.objects
    assert after.run_due_events(8.0) == []
    assert [one.description for one in after.run_due_events(9.0)] == ["table was removed"]


@pytest.mark.parametrize("text", [None, "", "\n", "{}\n{}\n", '{"elapsed_s": 1', "\xff"])
def test_unreadable_file_gives_no_state(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "world.jsonl"
    if text is not None:
        path.write_text(text, encoding="latin-1")

    assert StateFile(path).load() is None


def test_write_errors_are_raised(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file"):
        StateFile(tmp_path / "gone" / "world.jsonl").save(world(), 0.0)


def test_truncated_line_is_ignored(tmp_path: Path) -> None:
    path = tmp_path / "world.jsonl"
    file = StateFile(path)
    for elapsed_s in (1.0, 2.0):
        file.save(world(), elapsed_s)
    path.write_bytes(path.read_bytes()[:-5])

    kept = file.load()

    assert kept is not None
    assert kept.elapsed_s == 1.0


def test_file_size_is_bounded_and_the_newest_state_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "world.jsonl"
    file = StateFile(path)
    for number in range(2000):
        file.save(world(), float(number))

    assert path.stat().st_size < 300_000
    kept = file.load()
    assert kept is not None
    assert kept.elapsed_s == 1999.0


def test_half_line_of_a_full_disk_is_removed_by_the_next_save(tmp_path: Path) -> None:
    path = tmp_path / "world.jsonl"
    file = StateFile(path)
    file.save(world(), 1.0)
    with path.open("ab") as half, patch.object(Path, "open", side_effect=OSError("no space left")):
        half.write(b'{"elapsed_s":2')
        with pytest.raises(OSError, match="no space"):
            file.save(world(), 2.0)
    file.save(world(), 3.0)

    kept = file.load()

    assert kept is not None
    assert kept.elapsed_s == 3.0
