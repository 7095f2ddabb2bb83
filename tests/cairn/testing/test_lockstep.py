"""The lockstep harness runs a component or a deployment step by step, through its public API."""

from pathlib import Path

import pytest
import yaml

from cairn import (
    LATCHED,
    SECOND,
    CairnError,
    Component,
    Config,
    In,
    Out,
    ParameterRejected,
    every,
    on,
    to_ns,
)
from cairn.runtime.lifecycle import LifecycleState
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.geometry_msgs import Vector3
from cairn.schemas.std_msgs import String
from cairn.testing.lockstep import ComponentHarness, DeploymentHarness, Lockstep
from tests.wording import assert_words, words_in_order


class SumConfig(Config):
    factor: float = 1.0


class Sum(Component):
    """Adds what it receives, publishes the sum ten times a second, and ends on a word."""

    config: SumConfig
    number: In[Vector3]
    word: In[String] = In(qos=LATCHED)
    total: Out[Vector3]
    echo: Out[Vector3]

    def on_configure(self) -> None:
        self.sum = 0.0

    @on("number")
    def add(self, number: Vector3) -> None:
        self.sum += self.config.factor * number.x
        self.echo.publish(number)

    @on("word")
    def obey(self, word: String) -> None:
        self.finish(word.data)

    @every(hz=10)
    def publish(self) -> None:
        self.total.publish(Vector3(x=self.sum))


@pytest.fixture
def deployment(tmp_path: Path) -> Path:
    plugin = f"{__name__}:Sum"
    chain = {
        "first": {"plugin": plugin, "topics": {"total": "middle", "word": "word2"}},
        "last": {
            "plugin": plugin,
            "topics": {"number": "middle", "echo": "echo2"},
            "parameters": {"factor": 2.0},
            "significant": True,
            "restart": "transient",
        },
    }
    page = {"cairn": 1, "external_topics": ["number", "word", "word2"], "components": chain}
    file = tmp_path / "chain.yaml"
    file.write_text(yaml.safe_dump(page))
    return file


def test_component_receives_and_publishes_in_virtual_time() -> None:
    harness = ComponentHarness(Sum, {"factor": 3.0}, start_s=5.0)
    harness.publish("number", Vector3(x=1.0), Vector3(x=2.0))
    assert harness.take("echo") == [Vector3(x=1.0), Vector3(x=2.0)]
    assert (harness.now, harness.take("total")) == (5.0, [])

    harness.run_for(0.25)

    assert harness.take("total") == 2 * [Vector3(x=9.0)]
    assert harness.take("total") == []
    assert harness.published == [
        ("echo", 5 * SECOND),
        ("echo", 5 * SECOND),
        ("total", round(5.1 * SECOND)),
        ("total", round(5.2 * SECOND)),
    ]


def test_unhandled_messages_are_pending_until_time_advances() -> None:
    harness = ComponentHarness(Sum)
    harness.publish("number", Vector3(x=1.0), handled=False)
    assert harness.component.sum == 0.0

    harness.run_for(0.0)

    assert harness.component.sum == 1.0


def test_component_follows_life_cycle_requests_and_reports_its_end() -> None:
    harness = ComponentHarness(Sum, activate=False)
    assert harness.state is LifecycleState.UNCONFIGURED
    with pytest.raises(CairnError, match="cannot deactivate in state unconfigured"):
        harness.request("deactivate")

    harness.activate()
    harness.set_parameters({"factor": 2.0})
    with pytest.raises(ParameterRejected, match="factor"):
        harness.set_parameters({"factor": "many"})
    harness.publish("word", String(data="enough"))

    assert harness.component.config.factor == 2.0
    assert harness.end is not None
    assert harness.runtime.status().state == "finalized"
    assert harness.end.reason == "enough"


def test_components_beside_each_other_share_bus_and_time() -> None:
    first = ComponentHarness(Sum, name="first", topics={"total": "middle"})
    last = ComponentHarness(Sum, name="last", topics={"number": "middle"}, beside=first)
    first.publish("number", Vector3(x=4.0))
    first.run_for(0.3)

    assert last.now == 0.3
    assert last.take("echo")[-1] == Vector3(x=4.0)


def test_topic_of_another_type_fails_the_test_at_once() -> None:
    harness = ComponentHarness(Sum)

    with pytest.raises(AssertionError, match="total"):
        harness.read("total", String)


def test_reading_receives_messages_latched_before() -> None:
    lockstep = Lockstep()
    lockstep.publish("map", String(data="hall"), qos=LATCHED)

    assert lockstep.read("map", String).take() == [String(data="hall")]


def test_condition_that_never_holds_fails_with_the_limit_and_the_time() -> None:
    with pytest.raises(AssertionError, match=r"not within 2 s of virtual time.* 2\.000 s"):
        ComponentHarness(Sum).run_until(lambda: False, limit_s=2.0)


def test_deployment_runs_step_by_step(deployment: Path) -> None:
    with DeploymentHarness(deployment) as harness:
        total = harness.read("total", Vector3)
        harness.run_for(1.0)
        assert len(total.take()) == 10
        harness.publish("number", Vector3(x=1.0))

        harness.run_until(lambda: any(message.x for message in total.messages), limit_s=1.0)

        assert harness.now <= 1.2
        assert total.messages[-1].x == 2.0
        assert harness.state("last") is LifecycleState.ACTIVE
    assert harness.end is not None
    assert harness.end.normal


def test_deployment_takes_sets_requests_and_parameters(deployment: Path) -> None:
    sets = ["components.last.parameters.factor=5.0"]
    with DeploymentHarness(deployment, sets=sets) as harness:
        values = {one["name"]: one["value"] for one in harness.request("last", "parameters")}
        assert values == {
            "factor": 5.0,
            "log_level": "info",
            "service_introspection": "off",
        }
        harness.set_parameters("last", {"factor": 7.0})
        harness.request("first", "deactivate")
        assert harness.state("first") is LifecycleState.INACTIVE
        harness.request("first", "activate")
        with pytest.raises(CairnError, match=words_in_order("nowhere", "no component")):
            harness.request("nowhere", "deactivate")


def test_readings_opened_before_the_start_receive_everything(deployment: Path) -> None:
    harness = DeploymentHarness(deployment)
    statuses = harness.read("component_status", ComponentStatus)
    harness.start()

    first = [one.state for one in statuses.messages if one.component == "first"]
    assert first[:2] == ["inactive", "active"]
    assert all(to_ns(one.header.stamp) == 0 for one in statuses.messages)
    harness.shutdown()


def test_suspended_component_publishes_nothing_and_the_others_continue(deployment: Path) -> None:
    with DeploymentHarness(deployment) as harness:
        middle, total = harness.read("middle", Vector3), harness.read("total", Vector3)
        harness.suspend("first")
        harness.run_for(1.0)

        assert middle.messages == []
        assert len(total.messages) == 10


def test_condition_that_does_not_hold_by_the_end_of_the_deployment_fails_with_its_reason(
    deployment: Path,
) -> None:
    with DeploymentHarness(deployment) as harness:
        harness.publish("word", String(data="enough"))
        with pytest.raises(AssertionError) as failure:
            harness.run_until(lambda: False)

    assert_words(str(failure.value), "virtual time is 0.", "ended", "enough")


def test_deployment_that_ends_by_itself_is_run_to_its_end(deployment: Path) -> None:
    with DeploymentHarness(deployment) as harness:
        harness.publish("word", String(data="enough"))
        end = harness.run_to_end(limit_s=10.0)

    assert end.normal
    assert "enough" in end.reason
