"""The whole deployment, in lockstep: the same components, one thread, virtual time."""

from pathlib import Path

import pytest
from cairn.schemas.nav_msgs import Odometry
from cairn.testing.lockstep import DeploymentHarness

TURTLE = Path(__file__).parents[1] / "deploy" / "turtle.yaml"


def test_deployment_ends_when_the_turtle_has_traveled_its_distance() -> None:
    with DeploymentHarness(TURTLE, sets=["distance=5"], seed=1) as turtle:
        odom = turtle.read("odom", Odometry)
        turtle.run_until(lambda: len(odom.messages) >= 20)
        turtle.set_parameters("wanderer", {"speed": 0.8})
        end = turtle.run_to_end()

    assert end.normal
    assert "5.0 m traveled" in end.reason
    assert odom.messages[19].twist.twist.linear.x == pytest.approx(0.5)
    assert max(message.twist.twist.linear.x for message in odom.messages) == pytest.approx(0.8)


def test_wanderer_is_unloaded_when_the_battery_is_low(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", logger="cairn")
    high_use = ["components.base.parameters.used_per_m=0.6"]
    with DeploymentHarness(TURTLE, sets=high_use, seed=1) as turtle:
        turtle.run_for(20.0)

    messages = [record.getMessage() for record in caplog.records]
    logged = [message for message in messages if "wanderer" in message]
    assert logged[:3] == [
        "child active: wanderer",
        "child stopped: wanderer: shut down",
        "child active: wanderer",
    ]
