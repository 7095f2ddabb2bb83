"""`cairn check` warns of components whose QoS does not match."""

from pathlib import Path

from cairn import LATCHED, SENSOR, Component, In, Out, on
from cairn.bus.conflicts import qos_mismatch
from cairn.bus.qos import RELIABLE
from cairn.schemas.geometry_msgs import Twist
from tests.commands import cairn


class Driver(Component):
    speed: Out[Twist] = Out(qos=SENSOR)
    limit: Out[Twist] = Out(qos=LATCHED)


class Base(Component):
    command: In[Twist]
    limit: In[Twist]

    @on("command")
    def on_command(self, command: Twist) -> None: ...

    @on("limit")
    def on_limit(self, limit: Twist) -> None: ...


def test_check_warns_of_a_qos_that_does_not_match(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(
        "cairn: 1\nrobot: rover\ncomponents:\n"
        f"  driver: {{plugin: '{__name__}:Driver'}}\n"
        f"  base: {{plugin: '{__name__}:Base', topics: {{command: speed}}}}\n"
    )
    warning = qos_mismatch("/rover/speed", "/rover/driver", SENSOR, "/rover/base", RELIABLE)

    answer = cairn("check", str(file))
    assert (answer.code, answer.err) == (0, f"warning: {warning}\n")
    assert cairn("check", str(file), "--json").json["warnings"] == [warning]
