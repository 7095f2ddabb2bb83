"""The examples of docs/how-to/client.md run, in their order, against a simulated robot."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cairn.testing.launching import Launching

pytestmark = pytest.mark.xdist_group("robots in real time")


@pytest.mark.accuracy
def test_examples_of_the_page_run_against_the_simulated_robot(
    launch: Launching,
    root: Path,
    page_blocks: Callable[[str], Any],
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = launch(root / "deploy" / "sim.yaml")
    run.await_line("child active: mobile_supervisor")
    code = [
        block.text for block in page_blocks("docs/how-to/client.md") if block.language == "python"
    ]
    names: dict[str, Any] = {}

    for block in code:
        text = block.replace("client.connect()", f"client.connect({run.endpoint!r})")
        exec(compile(text, "docs/how-to/client.md", "exec"), names)

    printed = capsys.readouterr().out
    assert "mobile_supervisor    active" in printed
    assert "/robot/odom nav_msgs/msg/Odometry" in printed
    assert "succeeded after" in printed
    assert printed.count("canceled") >= 1
    assert len(names["distances"]) > 10
    assert run.stop() == 0
