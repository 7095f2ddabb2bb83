"""`cairn world` on a running simulation in real processes; killed components are restarted."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import yaml

from cairn.testing.launching import Run, launching
from tests.commands import Answer, await_status, cairn
from tests.components.simulation.worlds import box
from tests.patience import LIMIT_S
from tests.sweeps import sampled

pytestmark = pytest.mark.processes


TABLE = {"name": "table", "x": 1.5, "y": 3.0, "size": [0.8, 0.8]}
OBJECTS = [{"id": 1, "x": 6.0, "y": 2.0, "theta": 3.1416}]
ADA = {"name": "ada", "waypoints": [[5.0, 3.5]]}

COMPONENTS = """
    external_topics: [cmd_vel]
    supervision: {{max_restarts: 9}}
    components:
      world:
        plugin: simulated_world
        parameters: {{world: "{folder}/world.yaml", state_file: "{folder}/state.json"}}
      base: {{plugin: simulated_base}}
      range_scanner: {{plugin: simulated_scanner, parameters: {{rate: 10}}}}
      object_recognizer: {{plugin: simulated_recognizer}}
    """

World = Callable[..., Answer]


@pytest.fixture(autouse=True, scope="module")
def patience() -> Iterator[None]:
    """Await statuses and replies of the world however long a busy computer takes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cairn.components.simulation.cli._TIMEOUT_S", LIMIT_S)
        for limit in ("_GRAPH_LIMIT_S", "_STATUS_LIMIT_S", "_STATUS_PAUSE_S"):
            patch.setattr(f"cairn.client.connection.{limit}", 20.0)
        yield


@pytest.fixture(scope="module")
def simulation(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    """A running world with base, scanner and recognizer."""
    folder = tmp_path_factory.mktemp("simulation")
    file = folder / "world.yaml"
    file.write_text(yaml.safe_dump(box(furniture=[TABLE], objects=OBJECTS, people=[ADA])))
    with launching(folder) as launch:
        run = launch(COMPONENTS.format(folder=folder))
        run.await_line("child active: object_recognizer")
        yield run
        assert run.stop() == 0


@pytest.fixture
def world(simulation: Run) -> World:
    """Runs `cairn world` commands against it."""

    def against(*arguments: str) -> Answer:
        return cairn("world", *arguments, connect=simulation.endpoint)

    return against


def listed(world: World) -> dict[str, dict[str, Any]]:
    return {row["name"]: row for row in world("list", "--json").json}


def pose_of(row: dict[str, Any]) -> tuple[float, float, float]:
    return row["x"], row["y"], row["theta"]


def test_list_shows_furniture_objects_people_and_the_robot(world: World) -> None:
    rows = listed(world)

    assert {name: row["kind"] for name, row in rows.items()} == {
        "robot": "robot",
        "table": "furniture",
        "object_1": "object",
        "ada": "person",
    }
    assert pose_of(rows["table"]) == (1.5, 3.0, 0.0)
    assert "heading [rad]" in world("list").out


def test_add_move_and_remove_change_the_world(world: World) -> None:
    added = world("add", "crate", "4.5", "1.4", "30deg", "--size", "0.5,0.4")
    assert added.out == "crate was added\n"
    assert world("add", "poster", "2", "0", "90deg", "--object", "7").code == 0
    assert world("person", "eve", "1,0.5", "5,0.5", "--speed", "0.5").out == "eve was added\n"
    rows = listed(world)
    assert pose_of(rows["crate"]) == pytest.approx((4.5, 1.4, 0.5236), abs=1e-4)
    assert rows["poster"]["kind"] == "object"
    assert rows["eve"]["kind"] == "person"

    assert world("move", "crate", "4.4", "1.3", "-90deg").out == "crate was moved\n"
    assert pose_of(listed(world)["crate"]) == pytest.approx((4.4, 1.3, -1.5708), abs=1e-4)
    for name in ("crate", "poster", "eve"):
        assert world("remove", name).out == f"{name} was removed\n"
    assert set(listed(world)) == {"robot", "table", "object_1", "ada"}


def test_kidnap_moves_the_robot(world: World) -> None:
    assert world("kidnap", "5", "1", "90deg").out == "the robot was moved\n"
    assert pose_of(listed(world)["robot"]) == pytest.approx((5.0, 1.0, 0.5 * 3.14159), abs=1e-4)


class TestImpossibleChanges:
    @pytest.fixture(autouse=True, scope="class")
    @classmethod
    def nothing_changes(cls, simulation: Run) -> Iterator[None]:
        """Check after all of these tests that the table is where it was before them."""

        def table() -> Any:
            answer = cairn("world", "list", "--json", connect=simulation.endpoint)
            return next(row for row in answer.json if row["name"] == "table")

        before = table()
        yield
        assert table() == before

    @pytest.mark.parametrize(
        ("command", "message"),
        [
            (["kidnap", "0.1", "2"], "cannot be at (0.10, 2.00): wall 1 is 0.10 m from there"),
            (["kidnap", "-3", "2"], "outside the walls"),
            (
                ["move", "sofa", "1", "1"],
                "sofa does not exist; expected one of: ada, object_1",
            ),
            (["move", "tabel", "1", "1"], "tabel does not exist; did you mean table?"),
            (["move", "table", "north", "1"], "'north' is not a number"),
            (["move", "table", "nan", "1"], "nan is not a finite number"),
            (["move", "table", "0.1", "1"], "table overlaps wall 1 at (0.00, 1.00)"),
            (["add", "table", "1", "1"], "table exists already; choose another name"),
            (["add", "it", "1", "1", "--size", "big"], "--size big: write it as WIDTH,DEPTH"),
            (["add", "it", "3", "1", "--size", "0,1"], "size[0] = '0.0': must be greater than 0"),
            (["add", "it", "3", "1", "--size", "nan,1"], "(nan is not a finite number)"),
            (["add", "it", "3", "1", "--size", "1"], "--size 1: write it as WIDTH,DEPTH"),
            (
                ["add", "it", "50", "50", "--size", "1,1"],
                "it cannot be at (50.00, 50.00): the position is out",
            ),
            (
                ["move", "table", "50", "50"],
                "table cannot be at (50.00, 50.00): the position is outside",
            ),
            (["add", "it", "3", "0", "--object", "31", "--size", "1,1"], "--size is for furniture"),
            (["person", "eve", "1,nan"], "(nan is not a finite number)"),
            (["person", "eve", "1,1", "--speed", "nan"], "--speed nan is not a finite number"),
            (
                ["person", "eve", "1,1", "--speed", "4"],
                "speed = '4.0': must be less than or equal to 3",
            ),
            (["person", "eve", "1;2"], "1;2: write a waypoint as X,Y"),
            (
                ["person", "eve", "0.5,3", "3,3"],
                "eve cannot walk from (0.5, 3) to (3, 3): table is in",
            ),
            (["remove", "my desk"], "name = 'my desk': "),
        ],
    )
    def test_is_rejected_with_the_reason(
        self, world: World, command: list[str], message: str
    ) -> None:
        answer = world(*command)

        assert answer.code == 1
        assert message in answer.err
        assert answer.err.count("\n") == 1


def test_missing_running_world_is_reported_with_the_command_that_starts_one(
    simulation: Run,
) -> None:
    answer = cairn("world", "list", "--robot", "absent", connect=simulation.endpoint)

    assert answer.code == 1
    assert "no simulated_world is running: start one" in answer.err


def test_killed_world_continues_from_its_saved_state(simulation: Run, world: World) -> None:
    world("kidnap", "4", "1")
    world("move", "table", "1.2", "2.5")
    wait_until(lambda: '"x":1.2,"y":2.5,' in (simulation.report.parent / "state.json").read_text())
    old = simulation.pid_of("world")
    os.kill(old, signal.SIGKILL)

    simulation.await_line("restored the saved state of the world")
    await_status(
        "/robot/world",
        lambda row: row["state"] == "active" and row["pid"] != old,
        simulation.endpoint,
    )
    rows = listed(world)
    assert pose_of(rows["table"]) == (1.2, 2.5, 0.0)
    assert pose_of(rows["robot"])[:2] == (4.0, 1.0)


@pytest.mark.parametrize("part", sampled(["base", "range_scanner", "object_recognizer"]))
def test_killed_driver_is_restarted_and_works(simulation: Run, part: str) -> None:
    topic = {"base": "odom", "range_scanner": "scan", "object_recognizer": "objects"}[part]
    cairn("world", "kidnap", "3", "2", connect=simulation.endpoint)
    old = simulation.pid_of(part)
    os.kill(old, signal.SIGKILL)

    await_status(
        f"/robot/{part}",
        lambda row: row["state"] == "active" and row["pid"] != old,
        simulation.endpoint,
    )
    answer = cairn("topic", "echo", topic, "--count", "1", connect=simulation.endpoint)
    assert answer.code == 0
    assert "stamp" in answer.out


def wait_until(holds: Callable[[], bool]) -> None:
    """Wait until a file has the expected content; nothing announces that."""
    deadline = time.monotonic() + LIMIT_S
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.02)
