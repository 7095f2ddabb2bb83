"""A campaign gives a deployment a clock of its own, and steps it."""

import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from cairn_lab.campaign import CampaignReport, SkippedFault
from cairn_lab.campaign.stepped_clock import Clocks

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")

WATCH = """
import datetime, time
for _ in open(0):
    time.sleep(1e-4)  # libraries that change clocks are known to break it
    print(time.time(), datetime.datetime.now().timestamp(), time.monotonic(), flush=True)
"""
TREE = """
    cairn: 1
    components:
      mobile:
        plugin: supervisor
        children:
          talker: {plugin: test_talker}
          listener: {plugin: test_listener}
    """


@needs_compiler
def test_steps_change_the_system_time_of_running_processes_alone(tmp_path: Path) -> None:
    clocks = Clocks(["base", "brain"], tmp_path)
    with subprocess.Popen(
        [sys.executable, "-c", WATCH],
        env=dict(clocks.environment("base")),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as watch:

        def offsets() -> tuple[float, float]:
            """Return by how much its system time and its monotonic time are ahead of ours."""
            assert watch.stdin is not None
            assert watch.stdout is not None
            while True:
                ours, began = time.time(), time.monotonic()
                print(file=watch.stdin, flush=True)
                system, date, monotonic = map(float, watch.stdout.readline().split())
                if time.monotonic() - began < 0.3:  # else it says little about the clocks
                    break
            assert date == pytest.approx(system, abs=0.4)
            return system - ours, monotonic - began

        at_first = offsets()
        with clocks.stepped("base", 3600.0), clocks.stepped("base", -0.5):
            both = offsets()
        with clocks.stepped("brain", 3600.0):
            others = offsets()

        assert [one[0] for one in (at_first, both, others)] == pytest.approx(
            [0.0, 3599.5, 0.0],
            abs=0.4,  # a busy computer
        )
        assert both[1] == pytest.approx(0.0, abs=0.4)
        watch.communicate()


def test_step_is_skipped_without_a_compiler(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    clocks = Clocks(["base"], tmp_path)

    assert clocks.environment("base") == {}
    with pytest.raises(SkippedFault, match="apt-get install gcc"), clocks.stepped("base", 1.0):
        pass


@pytest.mark.parametrize("name", ["my reports", "12:30"])
def test_step_is_skipped_if_the_loader_cannot_read_the_folders_name(
    tmp_path: Path, name: str
) -> None:
    (tmp_path / name).mkdir()
    clocks = Clocks(["base"], tmp_path / name)

    assert clocks.environment("base") == {}
    with pytest.raises(SkippedFault, match="another folder"), clocks.stepped("base", 1.0):
        pass


@pytest.mark.accuracy
@needs_compiler
@pytest.mark.processes
def test_clock_of_a_deployment_is_stepped(campaign: Callable[..., CampaignReport]) -> None:
    steps = {"steps_s": [-3600, 3600], "shortest_s": 1.0, "longest_s": 2.0}
    report = campaign(
        TREE,
        faults=[{"kind": "clock_step", "parameters": steps}],
        invariants=["stays_up", "no_orphan", "ends_have_reasons"],
        count=2,
        interval_s=0.3,
        settle_s=3.0,
        recording=None,
    )

    assert not report.violations, report.text()
    assert len(report.injected) == 2
    output = (report.folder / "output.log").read_text(encoding="utf-8")
    set_back = re.findall(r"WARNING robot\.(\w+): time was set back", output)
    assert {"root", "mobile", "talker"} <= set(set_back), output
    words = [int(number) for number in re.findall(r"received (\d+)", output)]
    assert words == sorted(words)
