"""Short campaigns with real processes: faults are injected and undone, violations are recorded."""

import json
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from cairn import Config
from cairn.testing.launching import CAIRN
from cairn_lab.campaign import CampaignReport, Injection, Invariant, LogLine

pytestmark = pytest.mark.processes

TREE = """
    cairn: 1
    components:
      talker: {plugin: test_talker}
      mobile:
        plugin: supervisor
        supervision: {max_restarts: 100}
        children:
          listener: {plugin: test_listener}
          base: {plugin: test_faulty, parameters: {helpers: 1}}
    """

PROGRAM = "import sys; print('ready'); [print(line) for line in sys.stdin]"

CAMPAIGN = f"""
    cairn_campaign: 1
    deployment: tree.yaml
    programs: {{device: {json.dumps([sys.executable, "-c", PROGRAM])}}}
    seed: 484  # draws each kind of fault
    count: 12
    interval_s: 0.3
    settle_s: 0.5
    recording: null
    faults:
      - {{kind: kill}}
      - {{kind: stop, parameters: {{shortest_s: 0.2, longest_s: 0.5}}}}
      - {{kind: hold, parameters: {{components: [base], shortest_s: 0.2, longest_s: 0.5}}}}
      - {{kind: wrong_message}}
      - {{kind: flood, parameters: {{rate: 1000, shortest_s: 0.2, longest_s: 0.3}}}}
      - {{kind: disk_full, parameters: {{shortest_s: 0.2, longest_s: 0.5}}}}
      - {{kind: set_parameters, parameters: {{component: talker, values: {{volume: 7}},
          shortest_s: 0.2, longest_s: 0.3}}}}
      - {{kind: command, parameters: {{target: file, begin: ["true"], undo: ["true"],
          shortest_s: 0.2, longest_s: 0.3}}}}
      - {{kind: fault_command, parameters: {{program: device, lines: [unplug 2]}}}}
      - {{kind: kill_root}}
    invariants:
      - {{kind: stays_up}}
      - {{kind: no_orphan}}
      - {{kind: ends_have_reasons}}
      - {{kind: bounded_growth}}
    """


class Broken(Invariant):
    """An invariant with a defect."""

    def on_fault(self, at_s: float, kind: str, fault: Injection) -> Iterable[str]:
        raise ZeroDivisionError


class NoKill(Invariant):
    """Nothing is ever killed: an invariant that a campaign violates."""

    def on_fault(self, at_s: float, kind: str, fault: Injection) -> Iterable[str]:
        if kind == "kill":
            yield f"{fault.target} was killed"


@pytest.mark.accuracy
def test_faults_of_every_kind_are_injected_and_nothing_is_left(tmp_path: Path) -> None:
    (tmp_path / "tree.yaml").write_text(TREE, encoding="utf-8")
    file = tmp_path / "short.yaml"
    file.write_text(CAMPAIGN, encoding="utf-8")
    report = tmp_path / "report"

    ran = subprocess.run(
        [CAIRN, "campaign", str(file), "--report", str(report)], capture_output=True, text=True
    )

    assert ran.returncode == 0, ran.stdout + ran.stderr
    result = json.loads((report / "report.json").read_text(encoding="utf-8"))
    assert len(result["faults"]) == 12
    kinds = {one["kind"] for one in result["faults"] if not one["skipped"]}
    assert len(kinds) == 10, ran.stdout
    assert result["launches"] == 1 + sum(one["kind"] == "kill_root" for one in result["faults"])
    assert all(f"fault {number}: " in ran.stdout for number in range(1, 13))
    assert len(list(report.glob("logs*/root.log"))) == result["launches"]
    assert "unplug 2" in (report / "device.log").read_text(encoding="utf-8")


@pytest.mark.accuracy
def test_violation_is_reported_with_its_recording_and_rerun(
    campaign: Callable[..., CampaignReport],
) -> None:
    report = campaign(
        TREE,
        faults=[{"kind": "kill", "parameters": {"components": ["talker"]}}],
        invariants=["no_orphan", NoKill(Config()), Broken(Config())],
        count=1,
        interval_s=0.1,
        settle_s=1.0,
    )

    violation, defect = report.violations
    assert (violation.invariant, violation.text) == ("NoKill", "talker was killed")
    assert violation.faults == [1]
    assert defect.text.startswith("it raised ZeroDivisionError() at ")
    assert (report.folder / violation.recording).stat().st_size > 0
    assert f"`{violation.rerun}`" in (report.folder / "report.md").read_text(encoding="utf-8")
    rerun = subprocess.run(
        [CAIRN, *shlex.split(violation.rerun)[1:]], capture_output=True, text=True
    )
    assert rerun.returncode == 0, rerun.stdout + rerun.stderr
    assert "talker: equal" in rerun.stdout


MACHINES = """
    machines: {base: {address: 192.0.2.1}, brain: {address: 192.0.2.2}}
    components:
      talker: {plugin: test_talker}
      listener: {plugin: test_listener, machine: brain}
    """


class FindsMachines(Invariant):
    """Notes which machines are lost and found."""

    events: tuple[str, ...] = ()

    def on_log(self, line: LogLine) -> Iterable[str]:
        if line.text.startswith(("machine lost", "machine found: brain")):
            self.events += (f"{line.logger} {line.text.partition(';')[0][:20]}",)
        return ()


@pytest.mark.accuracy
def test_links_between_the_machines_of_a_deployment_are_cut_and_delayed(
    campaign: Callable[..., CampaignReport],
) -> None:
    machines = FindsMachines(Config())
    slow = {"latency_s": 0.05, "loss": 0.1, "shortest_s": 0.1, "longest_s": 0.2}
    report = campaign(
        MACHINES,
        faults=[
            {"kind": "link_cut", "parameters": {"shortest_s": 3.0, "longest_s": 3.1}},
            {"kind": "link_delay", "parameters": {"links": ["*-brain"], **slow}},
        ],
        invariants=["stays_up", "no_orphan", "ends_have_reasons", machines],
        seed=7,  # draws both kinds, the cut first
        count=2,
        interval_s=0.3,
        settle_s=8.0,
        recording=None,
    )

    assert not report.violations, report.text()
    assert {one.kind for one in report.injected} == {"link_cut", "link_delay"}, report.text()
    assert {one.target for one in report.injected} == {"base-brain"}
    assert {"root", "root_brain", "zygote_brain", "listener"} <= report.processes.keys()
    of_root = [one for one in machines.events if one.startswith("robot.root ")]
    assert of_root[-2:] == ["robot.root machine lost: brain:", "robot.root machine found: brain"]
    assert (report.folder / "logs1_brain" / "listener.log").exists()
