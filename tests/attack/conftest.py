"""Limits of each case, and the table of all groups at the end."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Generator, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from rich.table import Table

from cairn.testing.timing import BUSY_SHARE, Pauses
from tests.attack.robot import (
    MOST_MEMORY_MB,
    MOST_SECONDS,
    AttackedRobot,
    Harm,
    attacked_robot,
)

_AFTERWARD = "test_afterward"
_PAUSES = pytest.StashKey[Pauses]()

Cases = Callable[[Iterable[object]], None]
"""Counts the cases that one test makes at the same time; without a call it is one."""


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AttackedRobot]:
    """A robot that lets in every program on this computer."""
    folder: Path = tmp_path_factory.mktemp("robot")
    with attacked_robot(folder, "bus.allow_any_local_user=true") as robot:
        yield robot


@pytest.fixture
def cases(record_property: Callable[[str, object], None]) -> Cases:
    """Count the cases that a test makes at the same time."""

    def count(cases: Iterable[object]) -> None:
        record_property("cases", len(list(cases)))

    return count


@pytest.fixture
def unharmed(record_property: Callable[[str, object], None]) -> Callable[[AttackedRobot], None]:
    """Check that a robot drives, has collided with nothing, and runs in the same processes."""

    def check(robot: AttackedRobot) -> None:
        robot.reach_goal()
        harm = robot.harm()
        record_property("harm", vars(harm))
        assert (harm.collisions, harm.replaced) == (0, []), robot.run
        assert harm.peak_mb <= MOST_MEMORY_MB

    return check


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, None, None]:
    """Measure the pauses of this computer during a case."""
    item.stash[_PAUSES] = Pauses()
    with item.stash[_PAUSES]:
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Record how long a case takes, and fail it after 5 s, unless this computer was too busy.

    It is the time that the test takes, or that it has measured: the property `seconds`.
    The time that the test waits for periodic statuses, to read their counters, is not counted.
    """
    report = yield
    robot = getattr(item, "funcargs", {}).get("robot")
    waited_s = robot.take_waited_s() if isinstance(robot, AttackedRobot) else 0.0
    seconds: Any = dict(report.user_properties).get("seconds", report.duration - waited_s)
    report.user_properties.append(("seconds", seconds))
    is_case = report.when == "call" and not item.name.startswith(_AFTERWARD)
    if is_case and report.passed and seconds > MOST_SECONDS:
        share = item.stash[_PAUSES].share
        if share > BUSY_SHARE:
            report.user_properties.append(("busy", f"{item.name}: {seconds:.1f} s"))
            return report
        report.outcome = "failed"
        report.longrepr = f"refused after {seconds:.1f} s, later than {MOST_SECONDS:g} s"
    return report


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print the table of all groups."""
    groups: dict[str, list[Any]] = defaultdict(list)
    for outcome in ("passed", "failed"):
        for report in terminalreporter.getreports(outcome):
            if report.when == "call" and "tests/attack/" in report.nodeid:
                groups[Path(report.nodeid.partition("::")[0]).stem].append(report)
    if not groups:
        return
    table = Table(title="attacks")
    for title in ("group", "cases", "refused", "slowest [s]", "memory [MB]", "collisions",
                  "escalations"):  # fmt: skip
        table.add_column(title, justify="left" if title == "group" else "right")
    total = [0, 0]
    for group, reports in sorted(groups.items()):
        known = [(one, dict(one.user_properties)) for one in reports]
        cases = [(one, given) for one, given in known if f"::{_AFTERWARD}" not in one.nodeid]
        counts = [(int(given.get("cases", 1)), one.passed) for one, given in cases]
        attacked, refused = sum(n for n, _ in counts), sum(n for n, passed in counts if passed)
        seconds = [float(given.get("seconds", one.duration)) for one, given in cases]
        harms = [Harm(**given["harm"]) for _, given in known if "harm" in given]
        memory = [float(given["peak_mb"]) for _, given in known if "peak_mb" in given]
        memory += [harm.peak_mb for harm in harms]
        total = [total[0] + attacked, total[1] + refused]
        table.add_row(
            group.removeprefix("test_"),
            str(attacked),
            str(refused),
            f"{max(seconds, default=0.0):.1f}",
            f"{max(memory):.0f}" if memory else "-",
            str(sum(harm.collisions for harm in harms)) if harms else "-",
            str(sum(len(harm.replaced) for harm in harms)) if harms else "-",
        )
    table.add_row("all", *map(str, total), "", "", "", "", style="bold")
    terminalreporter.write_line("")
    Console(file=terminalreporter._tw._file, width=100).print(table)
    for report in (one for reports in groups.values() for one in reports):
        if busy := dict(report.user_properties).get("busy"):
            terminalreporter.write_line(f"slow, as this computer was busy: {busy}")
