"""`cairn deploy` with a real sshd on loopback; systemd's programs there are scripts of the test."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent

import pytest

from cairn.testing.launching import free_port
from tests.cairn.cli.releases.tiny_wheel import tiny_wheel
from tests.commands import Answer, cairn

_SSHD = shutil.which("sshd", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
pytestmark = [
    pytest.mark.processes,
    pytest.mark.slow,
    pytest.mark.skipif(_SSHD is None, reason="no sshd: install openssh-server"),
]

ROVER = """
    cairn: 1
    robot: rover
    external_topics: [wheel_motion]
    machines:
      base: {address: base.test}
      arm: {address: arm.test}
    settings: {label: first, world: "${here}/maps/hall.yaml"}
    components:
      world: {plugin: simulated_world, parameters: {world: "${world}"}}
    """
WORLD = """
    size: [4.0, 3.0]
    """
SYSTEMCTL = """\
    #!/bin/sh
    echo "$@" >> {there}/systemctl.log
    case "$1 $3" in
        is-enabled*) test -e {there}/enabled && echo enabled ;;
        *ExecStart) echo "ExecStart={{ path={there}/rover/current/environment/bin/cairn }}" ;;
        *ActiveState) echo "ActiveState=$(cat {there}/state)" ;;
        restart*)
            echo active > {there}/state
            if grep -q "label: crash" {there}/rover/current/rover.yaml; then
                echo failed > {there}/state
                exit 1
            fi ;;
    esac
    """
JOURNALCTL = """\
    #!/bin/sh
    echo "world: the floor is missing"
    """
SUDO = """\
    #!/bin/sh
    test "$2" = -l && exit 0
    shift
    exec "$@"
    """


@dataclass(frozen=True)
class There:
    """The other computer: its folder, the configuration of ssh for it, and what is pushed."""

    folder: Path
    config: Path
    file: Path
    wheel: Path

    @property
    def current(self) -> str:
        """The current release."""
        return (self.folder / "rover" / "current").resolve().name

    @property
    def releases(self) -> int:
        """The number of releases."""
        return len(list((self.folder / "rover" / "releases").iterdir()))

    def deploy(self, verb: str, *arguments: str, machines: tuple[str, ...] = ("base",)) -> Answer:
        """Run `cairn deploy` for machines."""
        named = [word for one in machines for word in ("--machine", one)]
        common = ("--folder", str(self.folder / "rover"), "--ssh-config", str(self.config))
        return cairn("deploy", verb, str(self.file), *named, *common, *arguments)

    def push(self, label: str, *machines: str) -> Answer:
        """Push the deployment with a label."""
        return self.deploy(
            "push", "--wheel", str(self.wheel), "--no-index", "--set", f"label={label}",
            machines=machines or ("base",),
        )  # fmt: skip


@pytest.fixture
def there(tmp_path: Path) -> Iterator[There]:
    """The other computer, running."""
    folder = tmp_path / "there"
    programs = folder / "bin"
    programs.mkdir(parents=True)
    (programs / "python3").symlink_to(Path(sys.base_prefix, "bin", "python3"))
    scripts = {"systemctl": SYSTEMCTL.format(there=folder), "journalctl": JOURNALCTL, "sudo": SUDO}
    for name, text in scripts.items():
        (programs / name).write_text(dedent(text))
        (programs / name).chmod(0o755)
    file = tmp_path / "here" / "robot.yaml"
    (file.parent / "maps").mkdir(parents=True)
    file.write_text(dedent(ROVER))
    (file.parent / "maps" / "hall.yaml").write_text(dedent(WORLD))
    with _sshd(tmp_path, f"{programs}:/usr/bin:/bin") as config:
        yield There(folder, config, file, tiny_wheel(tmp_path))


@pytest.mark.accuracy
def test_release_is_pushed_once_and_a_broken_one_is_rolled_back(there: There) -> None:
    pushed = there.push("first", "base", "arm")

    assert pushed.code == 1  # the other machine does not exist
    assert "is current; no service cairn@rover is installed" in pushed.out
    assert pushed.err.count("arm: ") == 1
    first = there.current
    release = there.folder / "rover" / "current"
    (copy,) = release.glob("files/**/hall.yaml")
    assert str(copy.relative_to(release)) in (release / "rover.yaml").read_text()
    assert (release / "environment" / "bin" / "cairn").exists()
    assert "base: unchanged: release" in there.push("first").out
    assert there.releases == 1

    (there.folder / "enabled").touch()
    (there.folder / "state").write_text("active\n")
    refused = there.push("refused")
    assert refused.code == 1
    assert "the check failed there, nothing has changed: the label is refused" in refused.err
    assert "restart" not in (there.folder / "systemctl.log").read_text()

    crashed = there.push("crash")
    assert crashed.code == 1
    assert "did not become active: cairn@rover.service is failed" in crashed.err
    assert "world: the floor is missing" in crashed.err
    assert f"rolled back to release {first}: cairn@rover.service was restarted" in crashed.err
    assert (there.current, there.releases) == (first, 1)

    second = there.push("second")
    assert second.code == 0, second.err
    assert "cairn@rover.service was restarted and is active" in second.out
    assert "installing" not in second.out  # both have the same packages
    assert there.current != first
    assert there.deploy("rollback").code == 0
    assert there.current == first
    listed = {row["release"]: row["is"] for row in there.deploy("list", "--json").json}
    assert listed[first] == "current"
    assert sorted(listed.values()) == ["current", "previous"]
    assert there.push("second").out.count("is there already") == 1


@contextmanager
def _sshd(folder: Path, path: str) -> Iterator[Path]:
    """Run an sshd on loopback, with keys of its own; yield the configuration of ssh for it."""
    user = pwd.getpwuid(os.geteuid()).pw_name
    for name in ("host", "login"):
        command = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(folder / name)]
        subprocess.run(command, check=True)
    if os.geteuid() == 0:  # as its service does before it starts
        Path("/run/sshd").mkdir(exist_ok=True)
    port = free_port()
    (folder / "sshd_config").write_text(
        f"ListenAddress 127.0.0.1:{port}\nHostKey {folder}/host\nPidFile none\nUsePAM no\n"
        f"AuthorizedKeysFile {folder}/login.pub\nStrictModes no\nPasswordAuthentication no\n"
        f"PermitRootLogin prohibit-password\nSetEnv PATH={path}\n"
    )
    (folder / "known_hosts").write_text(f"base.test {(folder / 'host.pub').read_text()}")
    config = folder / "ssh_config"
    config.write_text(
        f"Host base.test\n  HostName 127.0.0.1\n  HostKeyAlias base.test\n  Port {port}\n"
        f"  User {user}\n  IdentityFile {folder}/login\n  IdentitiesOnly yes\n"
        f"  UserKnownHostsFile {folder}/known_hosts\n"
        "Host arm.test\n  ProxyCommand false\n"
        "Host *\n  BatchMode yes\n"
    )
    command = [str(_SSHD), "-D", "-e", "-f", str(folder / "sshd_config")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        started = [process.stderr.readline()]
        while started[-1] and "Server listening" not in started[-1]:
            started.append(process.stderr.readline())
        try:
            assert started[-1], f"sshd does not start: {''.join(started)}"
            yield config
        finally:
            process.terminate()
