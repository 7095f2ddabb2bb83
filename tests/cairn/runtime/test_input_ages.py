"""Inputs whose newest message is too old are events for their component, and shown."""

from typing import Any

import pytest

from cairn import LATCHED, SECOND, CairnError, Component, In, from_ns
from cairn.runtime.component import ComponentContext
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.schemas.std_msgs import Header, String
from cairn.testing.lockstep import ComponentHarness


class Watcher(Component):
    """Records which of its inputs become stale and fresh."""

    word: In[String] = In(max_age_s=1.0)
    pose: In[PoseStamped] = In(optional=True)

    def __init__(self, context: ComponentContext) -> None:
        super().__init__(context)
        self.events: list[str] = []

    def on_stale(self, port: str, age_s: float) -> None:
        self.events.append(f"{port} stale at {self.clock.now() / SECOND:.1f}, {age_s:.1f} s old")

    def on_fresh(self, port: str) -> None:
        self.events.append(f"{port} fresh at {self.clock.now() / SECOND:.1f}")


def run_to(harness: ComponentHarness[Any], time_s: float) -> None:
    harness.run_to(round(time_s * SECOND))


def test_input_without_any_message_becomes_stale_after_its_age() -> None:
    harness = ComponentHarness(Watcher)
    run_to(harness, 0.9)
    assert harness.component.events == []
    run_to(harness, 3.0)
    assert harness.component.events == ["word stale at 1.2, 1.2 s old"]
    assert "no current word" in harness.runtime.status().reason


def test_stale_input_is_fresh_with_its_next_message() -> None:
    harness = ComponentHarness(Watcher)
    run_to(harness, 1.5)
    harness.publish("word", String(data="hello"))
    run_to(harness, 2.0)
    assert harness.component.events == ["word stale at 1.2, 1.2 s old", "word fresh at 1.6"]
    assert harness.runtime.status().reason == ""
    harness.publish("word", String(data="hello"))
    run_to(harness, 10.0)
    assert len(harness.component.events) == 3


def test_age_of_a_stamped_message_counts_from_its_stamp() -> None:
    harness = ComponentHarness(Watcher, max_age_s={"pose": 0.5, "word": 60.0})
    run_to(harness, 1.0)
    old = PoseStamped(header=Header(stamp=from_ns(round(0.2 * SECOND)), frame_id="map"))
    harness.publish("pose", old)
    run_to(harness, 2.0)
    assert harness.component.events == ["pose stale at 0.6, 0.6 s old"]
    harness.publish("pose", PoseStamped(header=Header(stamp=from_ns(2 * SECOND), frame_id="map")))
    run_to(harness, 2.2)
    assert harness.component.events[1:] == ["pose fresh at 2.1"]


def test_deactivated_component_does_not_judge_its_inputs() -> None:
    harness = ComponentHarness(Watcher)
    run_to(harness, 0.5)
    harness.request("deactivate")
    run_to(harness, 5.0)
    harness.request("activate")
    run_to(harness, 5.9)
    assert harness.component.events == []


@pytest.mark.parametrize("age_s", [0.0, -1.0, float("nan"), 4000.0])
def test_impossible_age_is_rejected(age_s: float) -> None:
    with pytest.raises(CairnError, match="an age is above 0"):
        In(max_age_s=age_s)


def test_latched_input_has_no_age() -> None:
    with pytest.raises(CairnError, match="last message stays valid"):
        In(qos=LATCHED, max_age_s=1.0)
