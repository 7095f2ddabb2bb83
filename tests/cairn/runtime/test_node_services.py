"""Every component has the services of a ROS 2 node, and a supervisor those of its children."""

from typing import Any

import numpy as np
import pytest
from pydantic import Field

from cairn import Component, Config, ParameterRejected, ServiceError
from cairn.bus.type_hash import type_hash
from cairn.runtime.node_services import python_value, ros_value
from cairn.schemas.composition_interfaces.srv import ListNodes, LoadNode, UnloadNode
from cairn.schemas.lifecycle_msgs.msg import State, Transition, TransitionEvent
from cairn.schemas.lifecycle_msgs.srv import (
    ChangeState,
    GetAvailableStates,
    GetAvailableTransitions,
    GetState,
)
from cairn.schemas.rcl_interfaces.msg import Parameter, ParameterEvent, ParameterValue
from cairn.schemas.rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from cairn.schemas.std_msgs import String
from cairn.schemas.type_description_interfaces.srv import GetTypeDescription
from cairn.testing.lockstep import ComponentHarness, DeploymentHarness


class Filter(Config):
    gain: float = Field(0.5, gt=0, le=1, description="Share of the new value [1].")


class TunedConfig(Config):
    count: int = Field(3, ge=1, le=10, description="Number [1].")
    enabled: bool = Field(True, description="Whether it works.")
    name: str = "x"
    filter: Filter = Filter()
    beams: tuple[float, ...] = (0.5, 1.0)
    poses: tuple[tuple[float, float], ...] = ((1.0, 2.0),)
    limit: float | None = None


class Tuned(Component):
    config: TunedConfig

    def on_parameters(self, new: Config) -> None:
        assert isinstance(new, TunedConfig)
        if new.name == "forbidden":
            raise ParameterRejected("name = 'forbidden' is not allowed")


@pytest.fixture
def tuned() -> ComponentHarness[Tuned]:
    return ComponentHarness(Tuned, name="tuned")


def parameter(name: str, value: Any) -> Parameter:
    return Parameter(name=name, value=ros_value(value))


def test_parameters_are_listed_with_their_groups(tuned: ComponentHarness[Tuned]) -> None:
    def listed(**request: Any) -> tuple[tuple[str, ...], tuple[str, ...]]:
        response = tuned.call(
            "tuned/list_parameters", ListParameters, ListParameters.Request(**request)
        )
        return response.result.names, response.result.prefixes

    names = ("count", "enabled", "name", "filter.gain", "beams", "poses", "limit")
    assert listed() == ((*names, "log_level", "service_introspection", "use_sim_time"), ("filter",))
    assert listed(prefixes=("filter",)) == (("filter.gain",), ("filter",))
    assert "filter.gain" not in listed(depth=1)[0]
    assert listed(prefixes=("unknown",)) == ((), ())


def test_values_and_types_are_those_of_ros(tuned: ComponentHarness[Tuned]) -> None:
    names = ("count", "enabled", "name", "filter.gain", "beams", "poses", "limit", "unknown")
    values = tuned.call(
        "tuned/get_parameters", GetParameters, GetParameters.Request(names=names)
    ).values
    types = tuned.call(
        "tuned/get_parameter_types", GetParameterTypes, GetParameterTypes.Request(names=names)
    ).types
    assert types.tolist() == [2, 1, 4, 3, 8, 4, 0, 0] == [value.type for value in values]
    assert values[0].integer_value == 3
    assert values[1].bool_value is True
    assert values[3].double_value == 0.5
    assert values[4].double_array_value.tolist() == [0.5, 1.0]
    assert values[5].string_value == "[[1.0, 2.0]]"


def test_descriptors_have_description_and_range(tuned: ComponentHarness[Tuned]) -> None:
    names = ("count", "filter.gain", "use_sim_time", "unknown")
    count, gain, time, unknown = tuned.call(
        "tuned/describe_parameters", DescribeParameters, DescribeParameters.Request(names=names)
    ).descriptors
    assert count.description == "Number [1]."
    assert (count.integer_range[0].from_value, count.integer_range[0].to_value) == (1, 10)
    assert gain.floating_point_range[0].to_value == 1.0
    assert gain.additional_constraints == "> 0, <= 1"
    assert time.read_only
    assert (unknown.name, unknown.type) == ("unknown", 0)


def test_parameters_are_set_each_or_all_or_none(tuned: ComponentHarness[Tuned]) -> None:
    events = tuned.read("/parameter_events", ParameterEvent)
    results = tuned.call(
        "tuned/set_parameters",
        SetParameters,
        SetParameters.Request(
            parameters=(
                parameter("count", 7), parameter("filter.gain", 3.0), parameter("count", "many"),
                parameter("unknown", 1), parameter("name", "forbidden"),
                parameter("use_sim_time", True), parameter("log_level", "debug"),
                Parameter(name="count", value=ParameterValue(type=77)),
            )
        ),
    ).results  # fmt: skip
    assert [one.successful for one in results] == [True, *[False] * 5, True, False]
    assert "filter.gain = 3.0 rejected" in results[1].reason
    assert "there is no parameter unknown" in results[3].reason
    assert "not allowed" in results[4].reason
    assert "read-only" in results[5].reason
    assert "no parameter type 77" in results[7].reason
    assert tuned.component.config.count == 7

    result = tuned.call(
        "tuned/set_parameters_atomically",
        SetParametersAtomically,
        SetParametersAtomically.Request(parameters=(parameter("count", 2), parameter("count", 99))),
    ).result
    assert not result.successful
    assert tuned.component.config.count == 7
    changed = [(one.name, one.value.type) for event in events.take()
               for one in event.changed_parameters]  # fmt: skip
    assert changed == [("count", 2), ("log_level", 4)]


@pytest.mark.parametrize(
    "value", [True, 5, -0.5, "text", [True, False], [1, 2], [0.5, 1.0], ["a", "b"], None]
)
def test_values_survive_the_way_to_ros_and_back(value: Any) -> None:
    assert python_value(Parameter(name="x", value=ros_value(value))) == value


def test_type_description_is_that_of_the_type(tuned: ComponentHarness[Tuned]) -> None:
    def described(name: str, hash_: str = "") -> GetTypeDescription.Response:
        return tuned.call(
            "tuned/get_type_description",
            GetTypeDescription,
            GetTypeDescription.Request(type_name=name, type_hash=hash_),
        )

    found = described("std_msgs/msg/String", type_hash(String))
    assert found.successful
    assert found.type_description.type_description.fields[0].name == "data"
    assert not described("std_msgs/msg/String", "RIHS01_00").successful
    assert "there is no package nowhere_msgs" in described("nowhere_msgs/msg/X").failure_reason


@pytest.mark.parametrize("state", ["unconfigured", "finalized"])
def test_parameters_are_served_in_every_state(state: str) -> None:
    tuned = ComponentHarness(Tuned, name="tuned", activate=False)
    request = GetParameters.Request(names=("count",))
    if state == "finalized":
        tuned.request("shutdown")
        with pytest.raises(ServiceError, match="no server"):
            tuned.call("tuned/get_parameters", GetParameters, request)
    else:
        values = tuned.call("tuned/get_parameters", GetParameters, request).values
        assert values[0].integer_value == 3


DEPLOYMENT = f"""
cairn: 1
components:
  boss:
    plugin: supervisor
    children:
      first: {{plugin: "{__name__}:Tuned"}}
      second: {{plugin: "{__name__}:Tuned", load: on_request}}
"""


@pytest.fixture
def boss(tmp_path: Any) -> Any:
    (tmp_path / "boss.yaml").write_text(DEPLOYMENT)
    with DeploymentHarness(tmp_path / "boss.yaml") as harness:
        yield harness


def state_of(boss: DeploymentHarness, name: str) -> str:
    return boss.call(f"{name}/get_state", GetState, GetState.Request()).current_state.label


def change(boss: DeploymentHarness, name: str, **transition: Any) -> bool:
    request = ChangeState.Request(transition=Transition(**transition))
    return bool(boss.call(f"{name}/change_state", ChangeState, request).success)


def test_life_cycle_of_a_child_is_seen_and_changed(boss: DeploymentHarness) -> None:
    events = boss.read("first/transition_event", TransitionEvent)
    assert state_of(boss, "first") == "active"
    assert change(boss, "first", id=Transition.TRANSITION_DEACTIVATE)
    boss.run_for(3.0)
    assert state_of(boss, "first") == "inactive"
    with pytest.raises(ServiceError, match="first is inactive: it cannot make transition 4"):
        change(boss, "first", id=Transition.TRANSITION_DEACTIVATE)
    assert change(boss, "first", label="activate")
    assert state_of(boss, "first") == "active"
    last = events.take()[-2:]
    assert [(one.start_state.label, one.goal_state.label) for one in last] == [
        ("active", "inactive"), ("inactive", "active"),
    ]  # fmt: skip


def test_states_and_transitions_are_described(boss: DeploymentHarness) -> None:
    states = boss.call(
        "first/get_available_states", GetAvailableStates, GetAvailableStates.Request()
    ).available_states
    assert State(id=3, label="active") in states
    request = GetAvailableTransitions.Request()
    possible, all_ = (
        boss.call(f"first/{name}", GetAvailableTransitions, request).available_transitions
        for name in ("get_available_transitions", "get_transition_graph")
    )
    assert [one.transition.label for one in possible] == ["deactivate", "shutdown"]
    assert len(all_) == 7


def test_supervisor_is_a_container_of_its_children(boss: DeploymentHarness) -> None:
    def listed() -> tuple[tuple[str, ...], list[int]]:
        response = boss.call("boss/_container/list_nodes", ListNodes, ListNodes.Request())
        return response.full_node_names, np.asarray(response.unique_ids).tolist()

    def load(**request: Any) -> LoadNode.Response:
        return boss.call("boss/_container/load_node", LoadNode, LoadNode.Request(**request))

    assert listed() == (("/robot/first",), [1])
    assert "there is no child 'third'" in load(node_name="third").error_message
    assert (
        "of the deployment"
        in load(node_name="second", parameters=(parameter("count", 1),)).error_message
    )
    assert load(node_name="second").unique_id == 2
    assert listed() == (("/robot/first", "/robot/second"), [1, 2])

    unload = boss.call("boss/_container/unload_node", UnloadNode, UnloadNode.Request(unique_id=2))
    assert unload.success
    assert state_of(boss, "second") == "unloaded"
    again = boss.call("boss/_container/unload_node", UnloadNode, UnloadNode.Request(unique_id=2))
    assert "no child with id 2 is loaded" in again.error_message
