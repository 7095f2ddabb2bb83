"""The commands of docs/how-to/tf.md print what the page shows, and its Python code runs."""

import re
import shlex
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cairn import SECOND, from_ns
from cairn.runtime.ports import ports_of
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage
from cairn.testing.lockstep import ComponentHarness
from cairn.tf import Transform
from tests.cairn.client.published_frames import frames_on_bus, stamped
from tests.cairn.tf.test_urdf import ROBOT
from tests.commands import cairn

PAGE = "docs/how-to/tf.md"


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with frames_on_bus() as (network, _):
        yield network.endpoint


def any_numbers(text: str) -> str:
    """A text with one number in place of each, and columns of any width."""
    return re.sub(r"  +", "  ", re.sub(r"-?\d+(\.\d+)?", "0", text))


@pytest.mark.processes
def test_commands_of_the_page_print_what_it_shows(
    endpoint: str, page_blocks: Callable[[str], Any]
) -> None:
    blocks = [one for one in page_blocks(PAGE) if one.language in ("sh", "text")]
    assert [one.language for one in blocks] == ["sh", "sh", "text", "sh", "text"]

    for command, shown in ((blocks[1], blocks[2]), (blocks[3], blocks[4])):
        answer = cairn(*shlex.split(command.text)[1:], connect=endpoint)
        assert (answer.code, answer.err) == (0, "")
        assert any_numbers(answer.out) == any_numbers(shown.text)


@pytest.mark.processes
def test_script_of_the_page_runs(
    endpoint: str, page_blocks: Callable[[str], Any], capsys: pytest.CaptureFixture[str]
) -> None:
    (script,) = [one.text for one in page_blocks(PAGE) if "client.connect()" in one.text]

    exec(script.replace("client.connect()", f"client.connect({endpoint!r})"), {})

    pose, points, identity = capsys.readouterr().out.splitlines()
    assert pose.startswith("(3.72")
    assert points.startswith("[[4.59")
    assert "Transform(translation=(" in identity


def test_component_of_the_page_uses_each_scan_when_its_transforms_are_there(
    page_blocks: Callable[[str], Any], caplog: pytest.LogCaptureFixture
) -> None:
    (block,) = [one for one in page_blocks(PAGE) if one.title]
    module = types.ModuleType("scan_in_map")
    exec(compile(block.text, block.title, "exec", dont_inherit=True), module.__dict__)
    harness = ComponentHarness(module.ScanInMap)

    def show(port: str, seconds: float, parent: str, child: str, x: float) -> None:
        edge = stamped(round(seconds * SECOND), parent, child, Transform((x, 0.0, 0.0)))
        harness.publish(port, TFMessage(transforms=(edge,)))
        if port == "tf":
            harness.run_for(0.01)

    for number, child in enumerate(("laser", "camera", "arm")):  # at once, as latched ones arrive
        show("tf_static", 0.0, "base_link", child, 0.1 + number)
    harness.run_for(0.01)
    show("tf", 1.0, "map", "base_link", 1.0)
    header = Header(stamp=from_ns(2 * SECOND), frame_id="laser")
    harness.publish(
        "scan",
        LaserScan(header=header, angle_increment=0.1, range_max=9.0, ranges=np.ones(1, np.float32)),
    )
    harness.run_for(0.01)
    show("tf", 1.5, "map", "base_link", 1.5)
    assert "scanner at" not in caplog.text
    show("tf", 3.0, "map", "base_link", 3.0)
    show("tf", 4.0, "map", "base_link", 4.0)

    depth_of = {port.name: port.qos.depth for port in ports_of(module.ScanInMap).values()}
    assert depth_of["tf_static"] >= 100  # over Zenoh, the messages of all publishers come at once
    assert caplog.text.count("scanner at") == 1
    assert "scanner at 2.10, 0.00, 0.00" in caplog.text


def test_robot_description_of_the_page_is_read(
    page_blocks: Callable[[str], Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (script,) = [one.text for one in page_blocks(PAGE) if "read_urdf_file(" in one.text]
    (tmp_path / "rover.urdf").write_text(ROBOT, encoding="utf-8")
    monkeypatch.chdir(tmp_path)

    exec(script, {})

    angles, movable = capsys.readouterr().out.splitlines()
    assert angles.startswith("(0.1")
    assert movable == "not static: ('wheel_joint',)"
