"""One robot on two computers: components exchange everything, and a cut cable is seen and survived.

Real processes in two network namespaces, with mutual TLS between their routers.
"""

import os
import re
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from mcap.reader import make_reader

from cairn.security.authority import Authority
from cairn.security.folder import VARIABLE, RobotFolder
from cairn.testing.launching import Run
from tests.commands import cairn
from tests.machines.conftest import Machines, two_machines
from tests.machines.network import eventually, missing
from tests.patience import LIMIT_S

pytestmark = [pytest.mark.processes, pytest.mark.xdist_group("machines")]

_TREE = """
    components:
      beacon: {plugin: test_beacon}
      mobile:
        plugin: supervisor
        children:
          listener: {plugin: test_listener, machine: brain%s}
          talker: {plugin: test_talker, restart: transient, significant: true%s}
      reader: {plugin: test_reader, machine: brain}
    """


def tree(machines: Machines, listener: str = "", talker: str = "") -> str:
    return machines.keys + re.sub("^    ", "", _TREE % (listener, talker), flags=re.MULTILINE)


def start(machines: Machines, deployment: str, *of_brain: str) -> tuple[Run, Run]:
    """Start both machines, the remote one first; return their runs when all is active."""
    brain = machines.up("brain", deployment, *of_brain)
    brain.await_line("waiting for machine: base")
    base = machines.up("base", deployment)
    base.await_line("root: child active: reader")
    return base, brain


@pytest.mark.accuracy
def test_nothing_is_lost_between_machines_and_commands_reach_both(machines: Machines) -> None:
    deployment = tree(machines, talker=", parameters: {words: 60}")
    records = deployment.replace("brain: {", "brain: {role: view, ", 1)
    base, brain = start(machines, records, "--record")
    # The latched message of a component that started long before, and every word from the first.
    brain.await_line("reader: the beacon stands at 4, 2")
    for machine in ("base", "brain"):
        rows = machines.rows(machine)
        assert {name for name, row in rows.items() if row["machine"] == "brain"} == {
            "root_brain",
            "listener",
            "reader",
            "recording",
            "recorder",
        }
        assert rows["listener"]["parent"] == "mobile"
        assert {row["state"] for row in rows.values()} == {"active"}
        assert (rows["listener"]["memory_mib"] is None) == (machine == "base")
        # Served by its parent on base and by itself on brain; that of reader by the root of base.
        for service in ("listener/get_state", "reader/get_state"):
            answer = machines.cairn(machine, "service", "call", service, "--json")
            assert answer.code == 0, (machine, answer)
            assert answer.json["current_state"]["label"] == "active"
        names = machines.cairn(machine, "service", "call", "listener/list_parameters", "--json")
        assert "log_level" in names.json["result"]["names"]
    assert machines.cairn("base", "param", "get", "listener", "log_level").code == 0
    brain.await_line("listener: received 60, the last was 60")
    assert base.await_end() == 0  # the talker has finished, which is significant
    brain.await_line("child stopped: listener")
    assert brain.stop() == 0
    with (brain.report / "recording.mcap").open("rb") as file:
        words = sum(1 for _ in make_reader(file).iter_messages(topics=["/robot/words"]))
    assert words == 60


@pytest.mark.accuracy
def test_components_of_both_machines_are_re_run_from_one_recording(machines: Machines) -> None:
    deployment = tree(machines, talker=", parameters: {words: 20}") + "call_log: true\n"
    brain = machines.up("brain", deployment)
    base = machines.up("base", deployment, "--record")
    brain.await_line("listener: received 20, the last was 20")
    assert base.await_end() == 0
    assert brain.stop() == 0
    recording = str(base.report / "recording.mcap")
    components = ("talker", "listener", "mobile")
    answer = cairn("rerun", recording, *(f"--component={name}" for name in components))
    for name in components:
        assert re.search(rf"^{name}: equal: \d", answer.out, re.MULTILINE), answer


@dataclass
class Pair:
    """A robot that runs on both machines, and their runs, of which a test may replace one."""

    machines: Machines
    deployment: str
    base: Run
    brain: Run


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pair]:
    """One robot for the tests that lose a machine, in their sequence: each finds both connected."""
    if reason := missing():
        pytest.skip(reason)
    with two_machines(tmp_path_factory.mktemp("pair")) as machines:
        deployment = tree(machines)
        yield Pair(machines, deployment, *start(machines, deployment))


def test_cut_cable_is_seen_and_all_goes_on_when_it_is_restored(pair: Pair) -> None:
    base, brain, machines = pair.base, pair.brain, pair.machines
    pid = brain.pid_of("listener")
    before = len(base.lines), len(brain.lines)
    machines.cable.is_cut = True
    base.await_line(
        r"root: machine lost: brain: machine brain has been silent for \d\.\d s; missing here: no",
        after=before[0],
    )
    base.await_line("mobile: child lost: listener: machine brain has been silent", after=before[0])
    brain.await_line(
        r"machine lost: base: .*missing here: .*/robot/words \(talker\) for listener",
        after=before[1],
    )

    def state() -> object:
        row = machines.rows("base").get("listener", {})
        return row.get("machine"), row.get("state")

    eventually(lambda: state() == ("brain", "lost"), LIMIT_S, "lost")
    (link,) = machines.cairn("base", "machines", "--json").json
    assert (link["machine"], link["state"]) == ("brain", "lost")
    machines.cable.is_cut = False
    base.await_line("mobile: child found: listener", after=before[0])
    seen = len(brain.lines)
    brain.await_line("listener: received", after=seen)
    assert brain.pid_of("listener") == pid  # nothing was restarted
    eventually(lambda: state() == ("brain", "active"), LIMIT_S, "active")


@pytest.mark.accuracy
def test_machine_that_restarts_has_its_components_loaded_again(pair: Pair) -> None:
    base, machines = pair.base, pair.machines
    before = len(base.lines)
    os.kill(pair.brain.process.pid, signal.SIGKILL)
    lost = base.await_line("mobile: child lost: listener", after=before)
    pair.brain.await_nothing_left()
    pair.brain = machines.up("brain", pair.deployment)
    base.await_line("mobile: child found: listener", after=lost)
    pair.brain.await_line("listener: received")
    assert machines.cairn("base", "restart", "listener").code == 0
    pair.brain.await_line("child stopped: listener: shut down")


@pytest.mark.accuracy
def test_machine_with_a_revoked_certificate_is_shut_out(pair: Pair) -> None:
    base, brain, machines = pair.base, pair.brain, pair.machines
    before = len(base.lines)
    Authority(RobotFolder.of("robot")).revoke("brain")
    base.await_line("machine lost: brain", after=before)
    brain.await_line("root_brain: links to other machines closed: .*brain.pem: no such file")
    refused = machines.launch(
        pair.deployment,
        "--machine",
        "brain",
        environment={VARIABLE: str(machines.security)},
        preexec_fn=machines.brain.enter,
    )
    assert refused.await_end() == 1
    refused.await_line("brain.pem: no such file; enroll brain on this computer")


@pytest.mark.accuracy
def test_without_the_other_machine_the_robot_starts_after_its_time_limit(
    machines: Machines,
) -> None:
    deployment = tree(machines, listener=", start_timeout_s: 1")
    base = machines.up("base", deployment.replace("reader: {", "reader: {on_loss: ignore, "))
    base.await_line("child lost: listener: machine brain cannot be reached")
    base.await_line("root: child active: mobile")
    assert base.stop() == 0


@pytest.mark.accuracy
def test_slow_and_lossy_link_loses_no_component(machines: Machines) -> None:
    machines.cable.delay_s, machines.cable.loss = 0.05, 0.1
    # The talker goes on: what it sent last before its end may arrive after the order to stop.
    base, brain = start(machines, tree(machines))
    brain.await_line("listener: received 40, the last was 40")
    assert not [line for line in (*base.lines, *brain.lines) if re.search(r"\w lost: ", line)]
    assert base.stop() == 0
    assert brain.stop() == 0


def test_deployment_without_an_identity_does_not_start(machines: Machines, tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    run = machines.launch(
        tree(machines),
        "--machine",
        "base",
        environment={"CAIRN_SECURITY_DIR": str(empty)},
    )
    assert run.await_end() == 1
    run.await_line("there are no certificates of the robot robot.*cairn security init")
