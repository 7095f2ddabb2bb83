"""A child on another machine: loaded, lost and found, never killed."""

from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

import pytest

from cairn import CairnError
from cairn.errors import Escalate
from cairn.processes.child import ChildUnavailable
from cairn.processes.supervisor import ChildGroup, StartFailed
from cairn.runtime.child_spec import ChildSpec, Fallback, OnLoss
from cairn.runtime.launch_request import LaunchRequest, RunContext
from cairn.runtime.lifecycle import LifecycleState
from cairn.runtime.process_exit import ExitReport
from cairn.schemas.cairn_msgs import MachineChild

from .scripted_children import World, fails


@dataclass
class ScriptedMachines:
    """The other machines as a test scripts them, on the world's clock."""

    world: World
    up: bool = True
    up_at_s: float = 0.0
    state: str = "unloaded"
    requests: list[str] = field(default_factory=list)
    errors: dict[str, CairnError] = field(default_factory=dict)
    unanswered: set[str] = field(default_factory=set)
    took_s: float | None = None

    def round_trip_s(self, machine: str) -> float | None:
        return self.took_s

    def silence(self, machine: str) -> str:
        is_up = self.up and self.world.now_s >= self.up_at_s
        return "" if is_up else f"machine {machine} cannot be reached"

    def child(self, machine: str, name: str) -> MachineChild | None:
        return MachineChild(name, self.state, 1, "")

    def request(
        self, machine: str, verb: str, arguments: Mapping[str, Any], timeout_s: float
    ) -> "Future[Any]":
        assert timeout_s > 0
        self.requests.append(" ".join([verb, *map(str, arguments.values()), "on", machine]))
        answer: Future[Any] = Future()
        if verb in self.unanswered:
            return answer
        if verb in self.errors:
            answer.set_exception(self.errors[verb])
            return answer
        states = {"load": "active", "unload": "unloaded"}
        self.state = states.get(verb) or ("active" if "active" in arguments.values() else "held")
        answer.set_result(self.state)
        return answer

    def wait_for_news(self, timeout_s: float) -> None:
        self.world.now_s += timeout_s


@dataclass
class Robot:
    world: World
    machines: ScriptedMachines
    children: ChildGroup

    def states(self) -> dict[str, str]:
        return {one.name: one.state for one in self.children.status()}

    def lose(self) -> None:
        self.machines.up = False
        self.children.check()

    def find(self) -> None:
        self.machines.up = True
        self.children.check()


def robot(on_loss: OnLoss = "degrade", fallback: Fallback | None = None) -> Robot:
    """Return a supervisor on machine `base` with a localizer on `brain` and a planner here."""
    world = World()
    machines = ScriptedMachines(world)
    world.robot_machines = machines
    remote = ChildSpec(
        plugin="test", machine="brain", on_loss=on_loss, start_timeout_s=20, fallback=fallback
    )
    here = ChildSpec(plugin="test", machine="base")
    specs = {"localizer": remote, "planner": here}
    if fallback is not None:
        specs["localizer_fallback"] = here.model_copy(update={"load": "on_request"})
    spec = ChildSpec(plugin="supervisor", children=specs)
    context = RunContext(machine="base", machines=("base", "brain"))
    launch = LaunchRequest(name="automove", spec=spec, context=context)
    children = ChildGroup(launch, world, world.log.logger, on_exit=lambda: None)
    return Robot(world, machines, children)


def test_remote_child_is_loaded_by_its_machine_before_the_next_one_starts() -> None:
    one = robot()
    one.world.on_step = one.machines.requests.append
    one.children.start_all()
    assert one.machines.requests == [
        "loading localizer on machine brain",
        "load localizer on brain",
        "launching planner",
        "starting planner: configure",
        "starting planner: activate",
    ]
    assert one.states() == {"localizer": "active", "planner": "active"}
    assert "launch localizer" not in one.world.steps


def test_start_waits_for_a_machine_that_is_not_up_yet() -> None:
    one = robot()
    one.machines.up_at_s = one.world.now_s + 10
    one.children.start_all()
    assert one.states()["localizer"] == "active"
    assert one.world.now_s >= one.machines.up_at_s


def test_start_goes_on_without_a_machine_that_never_comes() -> None:
    one = robot()
    one.machines.up = False
    before_s = one.world.now_s
    one.children.start_all()
    assert one.states() == {"localizer": "lost", "planner": "active"}
    assert 20 <= one.world.now_s - before_s < 21
    one.find()
    one.children.check()
    assert one.states()["localizer"] == "active"
    assert one.world.log.lines[-1] == "INFO child found: localizer"


def test_ignored_machine_is_not_waited_for_and_not_warned_of() -> None:
    one = robot("ignore")
    one.machines.up = False
    before_s = one.world.now_s
    one.children.start_all()
    assert one.states() == {"localizer": "lost", "planner": "active"}
    assert one.world.now_s == before_s
    assert not [line for line in one.world.log.lines if line.startswith(("WARNING", "ERROR"))]


def test_required_machine_that_never_comes_fails_the_supervisor() -> None:
    one = robot("stop")
    one.machines.up = False
    with pytest.raises(Escalate, match=r"localizer.*machine brain cannot be reached"):
        one.children.start_all()
    assert one.world.running() == []


def test_loss_and_return_are_logged_once_and_restart_nothing() -> None:
    one = robot()
    one.children.start_all()
    one.machines.requests.clear()
    one.world.take_steps()
    one.lose()
    one.lose()
    assert one.states() == {"localizer": "lost", "planner": "active"}
    one.find()
    one.find()
    assert one.states() == {"localizer": "active", "planner": "active"}
    assert one.world.log.lines[-2:] == [
        "WARNING child lost: localizer: machine brain cannot be reached",
        "INFO child found: localizer",
    ]
    assert (one.machines.requests, one.world.steps) == ([], [])


def test_loss_of_a_required_child_stops_its_siblings_and_fails_the_supervisor() -> None:
    one = robot("stop")
    one.children.start_all()
    with pytest.raises(Escalate, match="localizer is lost: machine brain cannot be reached"):
        one.lose()
    assert one.world.running() == []
    assert "it may continue to run there" in one.world.log.lines[-1]


def test_child_is_loaded_again_by_a_machine_that_was_restarted() -> None:
    one = robot()
    one.children.start_all()
    one.lose()
    one.machines.requests.clear()
    one.machines.state = "unloaded"
    one.find()
    assert one.machines.requests == ["load localizer on brain"]
    one.children.check()
    assert one.states()["localizer"] == "active"


def test_load_that_fails_is_tried_again_ever_less_often() -> None:
    one = robot()
    one.children.start_all()
    one.machines.requests.clear()
    one.machines.errors["load"] = CairnError("localizer: no rights on brain")
    one.machines.state = "unloaded"
    for _ in range(120):
        one.world.now_s += 0.5
        one.children.check()

    assert one.machines.requests == ["load localizer on brain"] * 6  # after 1, 2, 4, 8 and 16 s
    errors = [line for line in one.world.log.lines if "start failed: localizer" in line]
    assert "no rights on brain; trying again in 30 s" in errors[-1]
    assert len(errors) == 6
    one.machines.errors.clear()
    one.world.now_s += 30.0
    one.children.check()
    one.children.check()
    assert one.states()["localizer"] == "active"


def test_child_that_its_machine_restarts_is_not_touched() -> None:
    one = robot()
    one.children.start_all()
    one.machines.requests.clear()
    one.machines.state = "starting"
    one.children.check()
    assert one.states()["localizer"] == "active"  # the report may be from before it was loaded
    one.world.now_s += 1.0
    one.children.check()
    assert one.states()["localizer"] == "starting"
    assert one.machines.requests == []


def test_refused_start_fails_the_supervisor_with_the_reason_of_the_component() -> None:
    one = robot()
    one.machines.errors["load"] = CairnError("localizer: /maps/room.yaml: no such file")
    with pytest.raises(Escalate, match="no such file"):
        one.children.start_all()


def test_machine_that_is_lost_during_the_start_is_a_loss() -> None:
    one = robot()
    one.machines.errors["load"] = ChildUnavailable("/robot/root_brain: no reply")
    one.children.start_all()
    assert one.states()["localizer"] == "lost"


def test_stop_unloads_it_and_a_lost_machine_does_not_delay_the_stop() -> None:
    one = robot()
    one.children.start_all()
    one.children.stop_all()
    assert one.machines.requests[-1] == "unload localizer on brain"
    one.children.check_stops()
    one.children.start_all()
    one.lose()
    before_s = one.world.now_s
    one.children.stop_all()
    one.children.check_stops()
    assert one.world.now_s == before_s
    assert "it may continue to run there" in one.world.log.lines[-1]


def test_requests_of_users_reach_its_machine() -> None:
    one = robot()
    one.children.start_all()
    one.machines.requests.clear()
    one.children.hold("localizer", "inactive")
    assert one.states()["localizer"] == "held"
    one.children.restart("localizer")
    assert one.states()["localizer"] == "active"
    one.children.unload("localizer")
    one.children.check()
    assert one.machines.requests == [
        "hold localizer inactive on brain",
        "unload localizer on brain",
        "load localizer on brain",
        "unload localizer on brain",
    ]
    one.lose()
    with pytest.raises(CairnError, match="it does not run"):
        one.children.hold("localizer", LifecycleState.ACTIVE.value)


def test_load_on_request_goes_on_without_the_machine() -> None:
    one = robot()
    one.machines.up = False
    one.children.load("localizer")
    assert one.states()["localizer"] == "lost"
    refused = robot("stop")
    refused.machines.up = False
    with pytest.raises(StartFailed, match="machine brain cannot be reached"):
        refused.children.load("localizer")


def test_stop_during_the_load_unloads_what_the_machine_is_loading() -> None:
    one = robot()
    one.machines.unanswered.add("load")
    one.world.on_step = lambda step: (
        one.children.request_stop() if step.startswith("loading") else None
    )
    one.children.start_all()
    one.children.stop_all()
    assert one.machines.requests == ["load localizer on brain", "unload localizer on brain"]


def test_machine_is_found_also_if_its_component_is_still_starting_when_it_is_reached() -> None:
    one = robot()
    one.children.start_all()
    one.lose()
    one.machines.state = "starting"
    one.find()
    assert one.states()["localizer"] == "starting"
    one.machines.state = "active"
    one.children.check()
    assert one.world.log.lines[-1] == "INFO child found: localizer"


def test_stop_request_ends_the_wait_for_a_machine() -> None:
    one = robot()
    one.machines.up = False
    one.world.on_step = lambda _: one.children.request_stop()
    before_s = one.world.now_s
    one.children.start_all()
    assert one.world.now_s - before_s < 1
    assert one.states()["planner"] == "unloaded"


def test_fallback_works_while_the_machine_is_lost() -> None:
    one = robot(fallback=Fallback())
    one.children.start_all()
    assert one.states()["localizer_fallback"] == "unloaded"
    one.lose()
    assert one.states()["localizer_fallback"] == "active"
    one.find()
    assert one.states() == {
        "localizer": "active",
        "planner": "active",
        "localizer_fallback": "unloaded",
    }


def test_fallback_that_crashes_is_restarted_and_one_that_fails_is_tried_again() -> None:
    one = robot(fallback=Fallback())
    one.world.script("localizer_fallback", {"activate": fails("no map")})
    one.children.start_all()
    one.lose()
    assert one.states()["localizer_fallback"] == "ended"
    one.children.check()
    assert one.states()["localizer_fallback"] == "active"
    one.world.children["localizer_fallback"].end = ExitReport(False, "killed")
    one.children.reconcile()
    assert one.states()["localizer_fallback"] == "active"


def test_component_rests_while_its_link_is_slow() -> None:
    one = robot(fallback=Fallback(max_round_trip_s=0.3))
    one.children.start_all()
    one.machines.requests.clear()

    def checks(took_s: float, count: int) -> list[str]:
        one.machines.took_s = took_s
        for _ in range(count):
            one.children.check()
        return [one.machines.state, one.states()["localizer_fallback"]]

    assert checks(0.4, 2) == ["active", "unloaded"]
    assert checks(0.2, 1) == ["active", "unloaded"]
    assert checks(0.4, 3) == ["held", "active"]
    assert checks(0.2, 5) == ["held", "active"]
    assert checks(0.2, 1) == ["active", "unloaded"]
    assert one.machines.requests == [
        "hold localizer inactive on brain",
        "hold localizer active on brain",
    ]


def test_fallback_ends_with_the_component_that_it_stands_in_for() -> None:
    one = robot(fallback=Fallback())
    one.children.start_all()
    one.lose()
    one.children.unload("localizer")
    one.children.check()
    assert one.states()["localizer_fallback"] == "unloaded"
