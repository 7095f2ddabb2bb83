"""`cairn service install`: the unit's text, and the commands of systemd, which are scripts here."""

import shutil
import subprocess
from pathlib import Path
from textwrap import dedent

import pytest

from cairn.cli import systemd_service
from cairn.deployment.load import load_deployment
from cairn.deployment.model import Deployment
from cairn.processes.systemd_unit import RunCommand, drop_in_text, template_text
from tests.commands import Answer, cairn

ROVER = """
    cairn: 1
    robot: rover
    machines:
      base: {address: 192.0.2.1}
      arm: {address: 192.0.2.2}
    settings: {note: none}
    components:
      group: {plugin: supervisor}
    """
SYSTEMCTL = """\
    #!/bin/sh
    shift  # --user
    echo "$@" >> {folder}/log
    case "$1" in
        show) echo "ActiveState=$(cat {folder}/state)"
            printf 'SubState=running\\nResult=exit-code\\nUnitFileState=enabled\\n' ;;
        restart) test -e {folder}/broken && {{ echo failed > {folder}/state; exit 1; }}
            echo active > {folder}/state ;;
    esac
    """
JOURNALCTL = """\
    #!/bin/sh
    echo "scanner: there is no device"
    """


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "rover.yaml"
    path.write_text(dedent(ROVER), encoding="utf-8")
    return path


@pytest.fixture
def systemd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a user's service manager that always succeeds, unless it has file `broken`."""
    folder = tmp_path / "systemd"
    folder.mkdir()
    (folder / "state").write_text("inactive\n")
    for name, text in (("systemctl", SYSTEMCTL), ("journalctl", JOURNALCTL)):
        (folder / name).write_text(dedent(text).format(folder=folder))
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(folder), prepend=":")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setattr(systemd_service, "_BOOTED", folder)
    return folder


def install(file: Path, *arguments: str) -> Answer:
    return cairn("service", "install", str(file), "--machine", "base", "--user-unit", *arguments)


def test_service_is_installed_once_shown_and_removed(
    file: Path, systemd: Path, tmp_path: Path
) -> None:
    installed = install(file)

    assert installed.code == 0, installed.err
    assert "cairn@rover.service is enabled and active" in installed.out
    units = tmp_path / "config" / "systemd" / "user"
    drop_in = units / "cairn@rover.service.d" / "deployment.conf"
    assert f"cairn up {file} --plain" in drop_in.read_text()
    done = [line for line in (systemd / "log").read_text().splitlines() if "show" not in line]
    assert done == ["daemon-reload", "enable cairn@rover.service", "restart cairn@rover.service"]
    assert "is installed like this already" in install(file).out
    (row,) = cairn("service", "status", "--user-unit", "--json").json
    assert (row["service"], row["state"]) == ("cairn@rover", "active (running)")

    removed = cairn("service", "uninstall", "rover", "--user-unit")
    assert removed.code == 0, removed.err
    assert not [path for path in units.rglob("*") if path.is_file()]


def test_reason_is_reported_if_the_service_does_not_start(file: Path, systemd: Path) -> None:
    (systemd / "broken").touch()

    installed = install(file)

    assert installed.code == 1
    assert "scanner: there is no device" in installed.err
    assert "cairn@rover.service is failed (exit-code)" in installed.err


def test_deployment_with_a_problem_is_not_installed(file: Path, systemd: Path) -> None:
    file.write_text(file.read_text().replace("supervisor", "no_such_plugin"), encoding="utf-8")

    assert "there is no plugin no_such_plugin" in install(file).err
    assert not (systemd / "log").exists()


def test_without_systemd_the_error_says_so(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(systemd_service, "_BOOTED", tmp_path / "missing")

    assert "systemd does not run on this computer" in install(file).err
    shown = install(file, "--dry-run")
    assert shown.code == 0, shown.err
    assert "Type=notify" in shown.out


def test_unit_for_a_user_has_the_limits_but_no_rights_of_the_system() -> None:
    system, user = template_text(for_user=False), template_text(for_user=True)

    for line in ("Type=notify", "WatchdogSec=10", "KillMode=mixed", "MemoryMax=75%"):
        assert f"\n{line}\n" in system
        assert f"\n{line}\n" in user
    for key in ("User=", "DevicePolicy=", "IPAddressDeny=", "modprobe@", "network.target"):
        assert key in system
        assert key not in user
    assert user.rstrip().endswith("[Install]\nWantedBy=default.target")


def test_drop_in_quotes_the_command_and_allows_the_other_machines(file: Path) -> None:
    command = RunCommand(
        Path("/opt/cairn/bin/cairn"), file, Path("/var/lib/cairn/rover"), "base",
        [Path("/etc/cairn/my lab.yaml")], ['note=100% "$HOME"'],
    )  # fmt: skip

    text = drop_in_text(command, load_deployment(file), for_user=False)

    assert '--overlay "/etc/cairn/my lab.yaml" --set "note=100%% \\"$$HOME\\""\n' in text
    assert "IPAddressAllow=192.0.2.2\n" in text


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze")
def test_systemd_accepts_the_unit(file: Path, tmp_path: Path) -> None:
    deployment: Deployment = load_deployment(file)
    command = RunCommand(Path("/bin/true"), file, tmp_path, "base", [], ["note=a b"])
    unit = tmp_path / "cairn@rover.service"
    unit.write_text(template_text(for_user=False).replace("/opt/cairn/bin/cairn", "/bin/true"))
    folder = tmp_path / "cairn@rover.service.d"
    folder.mkdir()
    (folder / "deployment.conf").write_text(drop_in_text(command, deployment, for_user=False))

    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(unit)],
        capture_output=True, text=True, check=False, timeout=100,
    )  # fmt: skip

    assert "cairn@rover" not in done.stderr, done.stderr
