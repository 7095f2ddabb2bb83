"""What a supervisor does on order: load, unload, restart, and stop half-way."""

import pytest

from cairn.supervision.child import ChildEnd, ChildRules
from cairn.supervision.policy import Intensity, UnknownChild
from cairn.supervision.supervisor import StartFailed

from .scripted_children import (
    World,
    dies,
    fails,
)

CRASH = ChildEnd(False, "was killed by SIGSEGV")
DONE = ChildEnd(True, "ended with exit code 0")
START_BASE = ["launch base", "configure base", "activate base"]
START_SCANNER = ["launch scanner", "configure scanner", "activate scanner"]
STOP_BASE = ["deactivate base", "shutdown base"]
STOP_SCANNER = ["deactivate scanner", "shutdown scanner"]


@pytest.fixture
def world() -> World:
    return World()


def test_a_child_on_order_starts_when_ordered(world: World) -> None:
    supervisor = world.supervisor("base", ChildRules("automove", load="on_request"))
    supervisor.start_all()
    assert world.take_steps() == START_BASE
    supervisor.load("automove")
    supervisor.load("automove")
    assert world.take_steps() == ["launch automove", "configure automove", "activate automove"]
    world.children["automove"].end = CRASH
    supervisor.reconcile()
    assert world.running() == ["base", "automove"]


def test_an_order_that_fails_is_told_to_who_gave_it_and_counts_for_nothing(world: World) -> None:
    world.script("automove", *[{"configure": fails("unknown planner 'a-star'")}] * 10)
    supervisor = world.supervisor("base", ChildRules("automove", load="on_request"))
    supervisor.start_all()
    for _ in range(10):
        with pytest.raises(StartFailed, match=r"^automove: unknown planner"):
            supervisor.load("automove")
    supervisor.reconcile()
    assert world.running() == ["base"]


def test_a_child_that_dies_while_it_is_loaded_is_tried_again(world: World) -> None:
    world.script("automove", *[{"configure": dies("was killed by SIGKILL")}] * 3)
    supervisor = world.supervisor("base", ChildRules("automove", load="on_request"))
    supervisor.start_all()
    supervisor.load("automove")
    assert world.running() == ["base", "automove"]


def test_a_child_that_always_dies_while_it_is_loaded_is_not_loaded(world: World) -> None:
    world.script("automove", *[{"configure": dies("was killed by SIGKILL")}] * 10)
    supervisor = world.supervisor("base", ChildRules("automove", load="on_request"))
    supervisor.start_all()
    world.take_steps()
    with pytest.raises(StartFailed, match="was killed by SIGKILL"):
        supervisor.load("automove")
    assert world.steps.count("launch automove") == 4
    assert world.running() == ["base"]


def test_an_unloaded_child_stays_away(world: World) -> None:
    supervisor = world.supervisor("base", "scanner", strategy="one_for_all")
    supervisor.start_all()
    world.take_steps()
    supervisor.unload("scanner")
    assert world.take_steps() == STOP_SCANNER
    world.children["base"].end = CRASH
    supervisor.reconcile()
    assert world.take_steps() == START_BASE
    assert supervisor.status()[1].state == "unloaded"


def test_an_ordered_restart_stops_and_starts_one_child(world: World) -> None:
    supervisor = world.supervisor("base", "scanner", intensity=Intensity(0, 1.0))
    supervisor.start_all()
    world.take_steps()
    supervisor.restart("base")
    assert world.steps == STOP_BASE + START_BASE
    assert supervisor.status()[0].restarts == 0


def test_an_order_for_an_unknown_child_names_the_known_ones(world: World) -> None:
    with pytest.raises(UnknownChild, match="mobile_supervisor has no child lidar, but: base"):
        world.supervisor("base").load("lidar")


def test_a_stop_requested_during_a_start_ends_it_at_the_next_step(world: World) -> None:
    supervisor = world.supervisor("base", "scanner")

    def stop(text: str) -> None:
        if text == "starting base: configure":
            supervisor.request_stop()

    world.on_step = stop
    supervisor.start_all()
    assert world.take_steps() == ["launch base", "configure base"]
    supervisor.stop_all()
    assert world.steps == ["shutdown base"]
    assert world.running() == []


def test_a_stop_requested_while_a_start_keeps_failing_ends_the_retries(world: World) -> None:
    world.script("base", *[{"configure": dies("was killed by SIGSEGV")}] * 1000)
    supervisor = world.supervisor("base", intensity=Intensity(1000, 10.0))

    def stop(text: str) -> None:
        if len(world.steps) > 10:
            supervisor.request_stop()

    world.on_step = stop
    supervisor.start_all()
    supervisor.stop_all()
    assert len(world.steps) < 20
    assert world.running() == []


def test_a_stop_requested_during_an_ordered_load_stops_that_child(world: World) -> None:
    supervisor = world.supervisor(ChildRules("automove", load="on_request"))
    world.on_step = lambda text: supervisor.request_stop()
    with pytest.raises(StartFailed, match="a stop was requested"):
        supervisor.load("automove")
    assert world.running() == []
