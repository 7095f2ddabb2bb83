"""`cairn doctor` finds the faults of a computer, and names the remedy of each."""

import getpass
import grp
import os
import platform
import pty
import socket
import socketserver
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest

from cairn.cli.doctor import Finding
from cairn.cli.doctor.computer import computer
from cairn.cli.doctor.devices import cameras
from cairn.cli.doctor.machines import links
from cairn.processes.orphan_cleanup import MARK
from cairn.schemas.cairn_msgs import MachineLink, MachineStatus
from cairn.schemas.std_msgs import Header
from cairn.security.authority import Authority, AuthorityMember
from cairn.security.folder import VARIABLE, RobotFolder
from cairn.testing.launching import free_port, new_endpoint, new_socket
from tests.cairn.cli.conftest import Command
from tests.commands import Answer, cairn
from tests.patience import LIMIT_S
from tests.wording import assert_words

ROBOT = """
    cairn: 1
    bus: {{socket: {socket}}}
    external_topics: [cmd_vel]
    components:
      scanner: {{plugin: hokuyo_scanner, parameters: {{{device}}}}}
    """


def row_of(answer: Answer, subject: str) -> dict[str, Any]:
    """Return the finding about one subject."""
    found = {row["subject"]: row for row in answer.json}
    assert subject in found, f"no finding about {subject}; there are: {list(found)}"
    row: dict[str, Any] = found[subject]
    return row


def run_doctor(folder: Path, device: str) -> Answer:
    """Return the findings for a robot with this scanner."""
    file = folder / "robot.yaml"
    file.write_text(ROBOT.format(socket=new_socket(), device=device))
    return cairn("doctor", str(file), "--json")


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for processes of other tests, which may take long to end."""
    monkeypatch.setattr("cairn.cli.doctor.deployments._ENDING_LIMIT_S", LIMIT_S)


@contextmanager
def sleeping(**how: Any) -> Iterator["subprocess.Popen[bytes]"]:
    """A process that sleeps until the end of the context."""
    with subprocess.Popen(["sleep", "infinity"], **how) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture
def terminal() -> Iterator[str]:
    """A device that can be opened."""
    ours, theirs = pty.openpty()
    yield os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def test_healthy_computer_has_no_faults() -> None:
    answer = cairn("doctor", connect=new_endpoint())

    assert answer.code == 0, answer.out
    assert "ok    Python" in answer.out
    assert "free: no deployment runs" in answer.out
    assert answer.out.splitlines()[-1].startswith("no faults, ")


def test_running_robot_is_reported_by_name(command: Command) -> None:
    answer = command("doctor", "--json")

    assert [row["found"] for row in answer.json if "robot rover runs" in row["found"]]
    assert row_of(answer, "leftovers")["state"] == "ok"


@pytest.mark.parametrize(("limit_s", "state"), [(LIMIT_S, "ok"), (0.0, "fail")])
def test_process_is_a_leftover_only_if_it_stays_after_its_deployment(
    limit_s: float, state: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cairn.cli.doctor.deployments._ENDING_LIMIT_S", limit_s)
    with sleeping(env={**os.environ, MARK: "test"}) as process:
        wait = psutil.wait_procs

        def end_and_wait(left: list[psutil.Process], timeout: float) -> None:
            process.kill()
            wait(left, timeout)

        monkeypatch.setattr(psutil, "wait_procs", end_and_wait)
        answer = cairn("doctor", "--json", connect=new_endpoint())

    assert row_of(answer, "leftovers")["state"] == state
    assert (str(process.pid) in row_of(answer, "leftovers")["remedy"]) == (state == "fail")


def test_port_used_by_another_program_is_a_fault() -> None:
    with socketserver.TCPServer(("127.0.0.1", 0), socketserver.BaseRequestHandler) as server:
        threading.Thread(target=server.serve_forever).start()
        endpoint = f"tcp/127.0.0.1:{server.server_address[1]}"
        answer = cairn("doctor", "--json", connect=endpoint)
        server.shutdown()

    assert answer.code == 1
    assert row_of(answer, endpoint)["state"] == "fail"
    assert f"({os.getpid()})" in row_of(answer, endpoint)["found"]
    assert "--set bus.listen=" in row_of(answer, endpoint)["remedy"]


def test_each_fault_of_a_deployment_is_reported(tmp_path: Path) -> None:
    answer = run_doctor(tmp_path, "prt: /dev/ttyACM0")

    assert answer.code == 1
    [fault] = [row for row in answer.json if row["topic"] == "robot.yaml"]
    assert fault["state"] == "fail"
    assert "did you mean port" in fault["remedy"]


def test_device_that_another_process_has_open_is_reported(tmp_path: Path, terminal: str) -> None:
    with open(terminal, "rb") as device, sleeping(stdin=device) as sleeper:
        answer = run_doctor(tmp_path, f"port: {terminal}")

    assert row_of(answer, terminal)["state"] == "warn"
    assert_words(
        row_of(answer, terminal)["found"], "scanner.port", "in use", f"sleep ({sleeper.pid})"
    )


def test_process_that_emulates_a_device_is_not_reported(tmp_path: Path, terminal: str) -> None:
    answer = run_doctor(tmp_path, f"port: {terminal}")

    assert row_of(answer, terminal)["state"] == "ok"


def test_device_that_exists_and_is_free_is_ok(tmp_path: Path) -> None:
    answer = run_doctor(tmp_path, "port: /dev/random")

    assert row_of(answer, "/dev/random")["state"] == "ok"
    assert row_of(answer, "/dev/random")["found"] == "scanner.port"


def test_device_that_is_missing_is_a_fault(tmp_path: Path) -> None:
    missing = run_doctor(tmp_path, "port: /dev/serial/by-id/none")
    unplugged = run_doctor(tmp_path, 'port: "usb:15d1:0000"')

    assert missing.code == unplugged.code == 1
    assert row_of(missing, "/dev/serial/by-id/none")["found"] == "scanner.port: does not exist"
    assert "no such device is plugged in" in row_of(unplugged, "scanner.port")["found"]
    assert (
        "--set components.scanner.parameters.port=" in row_of(unplugged, "scanner.port")["remedy"]
    )


def test_file_that_is_missing_is_a_fault(tmp_path: Path) -> None:
    robot = Path(__file__).parents[3] / "deploy" / "robot.yaml"
    nowhere = tmp_path / "nowhere.cairn"

    answer = cairn("doctor", str(robot), "--set", f"settings.visual_map={nowhere}", "--json")

    missing = [row for row in answer.json if row["subject"] == str(nowhere)]
    assert [row["found"] for row in missing] == [
        "map_builder.map_file: does not exist",
        "object_recognizer.map_file: does not exist",
    ]
    assert {row["state"] for row in missing} == {"fail"}
    for row in missing:  # one setting names the file for both
        assert_words(row["remedy"], "create", "--set settings.visual_map=PATH")
    [there] = [row for row in answer.json if row["found"] == "map_builder.grid_file"]
    assert there["state"] == "ok"

    key = "components.mobile_supervisor.children.automove.children.map_builder.parameters.map_file"
    answer = cairn("doctor", str(robot), "--set", f"{key}={nowhere}", "--json")
    [row] = [row for row in answer.json if row["subject"] == str(nowhere)]
    assert_words(row["remedy"], "create", f"--set {key}=PATH")


def test_missing_graph_that_is_to_be_extended_is_a_fault(tmp_path: Path) -> None:
    nowhere = tmp_path / "nowhere.graph"

    answer = cairn("doctor", "mapping", "--set", f"extend={nowhere}", "--json")

    missing = [row["found"] for row in answer.json if row["subject"] == str(nowhere)]
    assert missing == ["slam.extend: does not exist"]


def test_file_that_may_not_be_read_is_a_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    grid = Path(__file__).parents[3] / "deploy" / "maps" / "room.yaml"
    file = tmp_path / "robot.yaml"
    file.write_text(
        f"cairn: 1\nexternal_topics: [scan, odom, localization]\n"
        f"components: {{map_builder: {{plugin: map_builder, parameters: {{grid_file: {grid}}}}}}}"
    )
    # The tests may run as root, which may read everything.
    monkeypatch.setattr(os, "access", lambda path, mode: path != grid)

    answer = cairn("doctor", str(file), "--json")

    assert row_of(answer, str(grid))["found"] == "map_builder.grid_file: may not be read"
    assert row_of(answer, str(grid))["state"] == "fail"


def test_network_device_is_checked_by_connecting(tmp_path: Path) -> None:
    port = free_port()  # which no other process takes once it is released
    with socket.create_server(("127.0.0.1", port)):
        reachable = run_doctor(tmp_path, f"host: 127.0.0.1, tcp_port: {port}")
    unreachable = run_doctor(tmp_path, f"host: 127.0.0.1, tcp_port: {port}")

    assert row_of(reachable, f"127.0.0.1:{port}")["found"] == "scanner.host: answers"
    assert row_of(unreachable, f"127.0.0.1:{port}")["state"] == "fail"
    assert "ping 127.0.0.1" in row_of(unreachable, f"127.0.0.1:{port}")["remedy"]


def test_network_device_in_use_is_not_disturbed(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = server.getsockname()
        with socket.create_connection(address):
            answer = run_doctor(tmp_path, f"host: 127.0.0.1, tcp_port: {address[1]}")
        server.accept()[0].close()
        server.settimeout(0.0)
        with pytest.raises(BlockingIOError):
            server.accept()

    finding = row_of(answer, f"127.0.0.1:{address[1]}")
    assert finding["state"] == "ok"
    assert f"({os.getpid()})" in finding["found"]


def test_remedy_for_a_missing_permission_is_the_group_to_join(
    tmp_path: Path, terminal: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    dialout = grp.getgrnam("dialout").gr_gid
    os.chmod(terminal, 0o660)
    os.chown(terminal, 0, dialout)
    # The tests may run as root, which may open everything.
    monkeypatch.setattr(os, "access", lambda path, mode: str(path) != terminal)
    monkeypatch.setattr(getpass, "getuser", lambda: "ada")

    answer = run_doctor(tmp_path, f"port: {terminal}")

    assert row_of(answer, terminal)["found"] == "scanner.port: may not be opened"
    assert row_of(answer, terminal)["remedy"].startswith("sudo usermod -aG dialout ada, then ")


@pytest.mark.parametrize(
    ("listed", "state", "remedy"),
    [
        ("kernel/drivers/usb/class/cdc-acm.ko: ", "warn", "linux-modules-extra"),
        ("kernel/drivers/usb/class/cdc_acm.ko.xz: ", "ok", ""),
    ],
)
def test_missing_kernel_drivers_are_reported(
    tmp_path: Path, listed: str, state: str, remedy: str
) -> None:
    folder = tmp_path / "lib/modules" / platform.release()
    folder.mkdir(parents=True)
    (folder / "modules.dep").write_text(listed)

    finding = found(computer(tmp_path), "driver cdc_acm")

    assert finding.state == state
    assert remedy in finding.remedy


def test_processor_that_stays_slow_is_reported(tmp_path: Path) -> None:
    core = tmp_path / "sys/devices/system/cpu/cpu0/cpufreq"
    core.mkdir(parents=True)
    (core / "scaling_governor").write_text("powersave\n")
    (core / "scaling_driver").write_text("acpi-cpufreq\n")

    assert found(computer(tmp_path), "processor").state == "warn"


def test_cameras_are_reported_with_stable_names(tmp_path: Path) -> None:
    for number in (0, 1):
        interface = tmp_path / "sys/devices/usb1/1-2/1-2:1.0"
        node = interface / f"video4linux/video{number}"
        node.mkdir(parents=True)
        (node / "name").write_text("Stereo Vision 1\n")
        (node / "index").write_text(f"{number}\n")
        (node / "device").symlink_to(interface)
        (tmp_path / "sys/class/video4linux").mkdir(parents=True, exist_ok=True)
        (tmp_path / f"sys/class/video4linux/video{number}").symlink_to(node)
    for name, text in {"idVendor": "32e4", "idProduct": "9750", "serial": "7"}.items():
        (tmp_path / "sys/devices/usb1/1-2" / name).write_text(f"{text}\n")

    [finding] = cameras(tmp_path)

    assert "Stereo Vision 1; stable names: usb:32e4:9750:7, port:1-2" in finding.found
    assert finding.state == "fail"  # the node itself does not exist


def found(findings: Iterator[Finding], subject: str) -> Finding:
    """Return the finding about that subject."""
    return next(finding for finding in findings if finding.subject == subject)


def test_who_may_connect_to_a_deployment_is_reported(tmp_path: Path) -> None:
    password = tmp_path / "password"
    password.touch(mode=0o600)
    password.write_text("hunter2")
    file = tmp_path / "robot.yaml"
    file.write_text(ROBOT.format(socket=new_socket(), device="port: /dev/null"))
    users = f"{{anna: {{role: operate, password_file: {password}}}}}"
    remote = ("--set", "bus.allow_remote=true", "--set", f"bus.users={users}", "--set")

    own_group = grp.getgrgid(os.getegid()).gr_name
    group = cairn("doctor", str(file), "--json", "--set", f"bus.group={own_group}")
    listening = cairn("doctor", str(file), "--json", *remote, "bus.listen=[tcp/0.0.0.0:7]")
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o700)
    inside = ("--set", f"bus.group={own_group}", "--set", f"bus.socket={closed}/cairn/a.sock")
    unreachable = cairn("doctor", str(file), "--json", *inside)
    quick = ("bus.allow_any_local_user=true", "--set", "bus.listen=[tcp/127.0.0.1:7]")
    open_to_all = cairn("doctor", str(file), "--json", "--set", *quick)

    def access(answer: Answer) -> list[tuple[str, str]]:
        topic = "access to robot.yaml"
        return [(row["state"], row["found"]) for row in answer.json if row["topic"] == topic]

    local = "the user who runs it"
    assert access(group) == [("ok", f"{local}, and the members of group {own_group}")]
    assert access(unreachable) == [
        (
            "warn",
            f"{local}, and the members of group {own_group}, "
            f"but {closed} is open to its owner alone",
        )
    ]
    assert access(listening) == [
        ("ok", local),
        ("warn", "by password: anna (operate); not encrypted"),
    ]
    assert access(open_to_all)[1][0] == "warn"
    assert "every program of every user" in access(open_to_all)[1][1]


def test_identities_of_machines_are_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "security"))
    file = tmp_path / "robot.yaml"
    file.write_text(
        "cairn: 1\nmachines: {base: {address: 10.9.0.1}, brain: {address: 10.9.0.2}}\n"
        "components: {supervision: {plugin: supervisor}}\n"
    )
    folder = RobotFolder.of("robot")
    missing = row_of(cairn("doctor", str(file), "--json"), str(folder.path))
    assert missing["state"] == "fail"
    assert_words(missing["remedy"], "cairn security init")
    members = [
        AuthorityMember(name, None, (f"10.9.0.{end}",)) for end, name in ((1, "base"), (3, "arm"))
    ]
    Authority.create(folder, members, days=10)
    row = row_of(cairn("doctor", str(file), "--json"), "base")
    assert row["state"] == "warn"
    assert_words(row["found"], "valid until", "for 9 days")
    Authority(folder).renew("base", grace_s=0)
    assert row_of(cairn("doctor", str(file), "--json"), "base")["state"] == "ok"
    folder.key("base").chmod(0o644)
    row = row_of(cairn("doctor", str(file), "--json"), "base")
    assert row["state"] == "fail"
    assert_words(row["found"], "other users may read")


def test_links_and_clocks_of_machines_are_checked() -> None:
    seen = (
        MachineLink("brain", is_up=True, clock_offset=0.0012, clock_error=0.0003),
        MachineLink("arm", is_up=True, clock_offset=-2.0, clock_error=0.01),
        MachineLink("lift", silent_s=12.0),
        MachineLink("cart", is_up=True),
    )
    found = list(links("robot", [MachineStatus(Header(), "base", links=seen)]))
    assert [one.state for one in found] == ["ok", "warn", "fail", "ok"]
    assert_words(found[0].found, "1.2 ms ahead, within 0.3 ms")
    assert_words(found[1].remedy, "chrony")
    assert_words(found[2].found, "lost", "12 s")
    assert_words(found[2].remedy, "--machine lift")
    assert found[3].subject == "cart seen from base"
