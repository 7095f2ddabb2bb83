"""The live view of `cairn up` fits the terminal and shows what matters."""

import io

import pytest
from rich.console import Console

from cairn.cli.live_view import LiveView
from cairn.schemas.cairn_msgs import ComponentStatus, PortStatus
from cairn.schemas.rcl_interfaces import Log
from cairn.schemas.std_msgs import Header

REPORT = "/home/someone/.local/state/cairn/runs/20261123-181500-123456-with-a-very-long-name-sim"


def drawn(width: int, height: int, components: int) -> list[str]:
    """The lines of a view with these many components, of which the last is not loaded."""
    console = Console(width=width, height=height, file=io.StringIO(), force_terminal=False)
    view = LiveView(console, "sim.yaml: robot robot", {"listens at:": "a.sock", "report:": REPORT})
    names = [f"component_{number}" for number in range(components)]
    port = PortStatus(
        port="scan", topic="scan", direction=PortStatus.IN, messages=1_234_567, dropped=89
    )
    root = ComponentStatus(header=Header(), component="root", state="active", pid=1)
    view.status(ComponentStatus(**{**vars(root), "children": tuple(names)}))
    for name in names[:-1]:
        view.status(
            ComponentStatus(
                header=Header(),
                component=name,
                parent="root",
                state="finalized",
                pid=4_194_304,
                handler="a handler with a long name",
                ports=(port,),
            )
        )
    for number in range(50):
        view.log(Log(level=Log.INFO, name="robot.root", msg=f"event {number}: {'x' * 200}"))
    view.log(Log(level=Log.ERROR, name="robot.base", msg=f"broken: {'long ' * 40}the reason"))
    view.log(Log(level=Log.INFO, name="robot.root", msg="newest"))
    console.print(view.picture())
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


@pytest.mark.parametrize("components", [3, 12, 60])
@pytest.mark.parametrize("size", [(90, 24), (80, 24), (200, 60)])
def test_newest_records_are_in_view_at_any_size(size: tuple[int, int], components: int) -> None:
    lines = drawn(*size, components)

    assert len(lines) < size[1]
    assert max(map(len, lines)) <= size[0]
    assert lines[-1].endswith("robot.root: newest")
    assert any("the reason" in line for line in lines), "an error is shown whole"
    assert any("a.sock" in line for line in lines)
    assert any(line.rstrip().endswith("-sim") for line in lines), "the end of the report's folder"


def test_components_that_are_not_loaded_are_shown_as_such() -> None:
    assert any("component_4" in line and "not loaded" in line for line in drawn(90, 30, 5))


@pytest.mark.parametrize("width", range(52, 110))
def test_numbers_are_whole_or_left_out(width: int) -> None:
    lines = drawn(width, 24, 5)
    (row,) = (line for line in lines if "component_2" in line)
    (titles,) = (line for line in lines if line.startswith("component "))
    assert "…" not in row.partition("a han")[0], row
    assert row.split()[:2] == ["component_2", "finalized"]
    assert "89" in row.split()
    assert ("1,234,567" in row.split()) == (" in " in titles)
    assert ("4194304" in row.split()) == (" pid" in titles)
    known = {"component", "state", "CPU", "%", "in", "out", "dropped", "restarts", "pid", "handler"}
    assert set(titles.split()) <= known
