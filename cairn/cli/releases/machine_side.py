"""What `cairn deploy` runs on a machine, as `python3 -c` with this file's text: no Cairn is there.

It uses the standard library only. The argument is a request in JSON, the output an answer in JSON.
Activation, and going back from a release that does not start, happen here, so that they are
completed if the connection is lost.
"""

from __future__ import annotations

import fcntl
import getpass
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import IO, Any

_CHECK_LIMIT_S = 300.0
_INSTALL_LIMIT_S = 3600.0  # a slow board may compile packages
_SYSTEMD_LIMIT_S = 30.0
_LONGEST_REASON = 4000  # characters
_OLDEST_PYTHON = (3, 11)


class RequestFailed(Exception):
    """The request fails: what is wrong, and what to do."""


class ReleaseFolder:
    """The folder of one robot's releases on this machine, and its service."""

    def __init__(self, folder: str, robot: str) -> None:
        """`folder` is created by `prepare`."""
        self.folder = Path(folder).expanduser()
        self.robot = robot
        self.releases = self.folder / "releases"
        self.environments = self.folder / "environments"
        self.current = self.folder / "current"
        self.service = SystemdService(f"cairn@{robot}.service", self.current)

    def prepare(self) -> None:
        """Create the folders."""
        try:
            for folder in (self.releases, self.environments):
                folder.mkdir(mode=0o750, parents=True, exist_ok=True)
            if not os.access(self.folder, os.W_OK):
                raise PermissionError(13, "Permission denied")
        except OSError as error:
            base = shlex.quote(str(self.folder))
            raise RequestFailed(
                f"{self.folder} cannot be written: {error.strerror}; create it on that machine: "
                f"sudo install -d -o {getpass.getuser()} -g cairn -m 2750 {base}"
            ) from error

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the lock of this robot's folder."""
        descriptor = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise RequestFailed(
                    "another push or rollback is in progress; wait for it"
                ) from error
            yield
        finally:
            os.close(descriptor)

    def ids(self) -> list[str]:
        """Return the ids of the complete releases, the oldest first."""
        if not self.releases.is_dir():
            return []
        return sorted(one.name for one in self.releases.iterdir() if self.described(one.name))

    def described(self, release: str) -> dict[str, Any] | None:
        """Return the description of a release, None if it is not complete."""
        try:
            text = (self.releases / release / "release.json").read_text("utf-8")
            found: dict[str, Any] = json.loads(text)
        except (OSError, ValueError):
            return None
        return found

    def linked(self, name: str) -> str:
        """Return the id of the release that `current` or `previous` is; "" if there is none."""
        try:
            found = Path(os.readlink(self.folder / name)).name
        except OSError:
            return ""
        return found if self.described(found) else ""

    def link(self, name: str, release: str) -> None:
        """Let `current` or `previous` be a release, in one step; with "", remove the link."""
        if not release:
            (self.folder / name).unlink(missing_ok=True)
            return
        part = self.folder / f"{name}.part"
        part.unlink(missing_ok=True)
        part.symlink_to(Path("releases") / release)
        part.replace(self.folder / name)

    def state(self) -> dict[str, Any]:
        """Return what is there."""
        releases = [{**(self.described(one) or {}), "id": one} for one in self.ids()]
        return {
            "folder": str(self.folder),
            "current": self.linked("current"),
            "previous": self.linked("previous"),
            "releases": releases,
            "environments": [one.parent.name for one in self.environments.glob("*/complete")],
            "service": self.service.state(),
            "python": list(sys.version_info[:2]),
        }

    def receive(
        self, release: str, description: dict[str, Any], environment: dict[str, Any], count: int
    ) -> None:
        """Unpack a release of `count` files from stdin, install its packages and check it.

        It is removed on failure.
        """
        incoming = self.folder / "incoming"
        shutil.rmtree(incoming, ignore_errors=True)
        target = self.releases / release
        try:
            if unpack(sys.stdin.buffer, incoming) != count:
                raise RequestFailed("the connection was lost before all was copied")
            digest = environment["digest"]
            if digest:
                self.install(digest, environment, incoming / "wheels")
            given = Path(environment["path"]).expanduser().absolute()
            place = self.environments / digest if digest else given
            (incoming / "release" / "environment").symlink_to(
                Path("..") / ".." / "environments" / digest if digest else place
            )
            os.replace(incoming / "release", target)
            command = [str(place / "bin" / "cairn"), "check", str(target / f"{self.robot}.yaml")]
            succeeded, text = run(command, _CHECK_LIMIT_S)
            if not succeeded:
                raise RequestFailed(f"the check failed there, nothing has changed: {text}")
            description = {**description, "environment": digest or environment["path"]}
            (target / "release.json").write_text(json.dumps(description, indent=2), "utf-8")
            os.sync()
        except BaseException:
            shutil.rmtree(target, ignore_errors=True)
            raise
        finally:
            shutil.rmtree(incoming, ignore_errors=True)

    def install(self, digest: str, environment: dict[str, Any], wheels: Path) -> None:
        """Create a virtual environment with packages, unless there is one already."""
        place = self.environments / digest
        if (place / "complete").exists():
            return
        shutil.rmtree(place, ignore_errors=True)
        python = str(place / "bin" / "python")
        packages = [*map(str, sorted(wheels.glob("*.whl"))), *environment["requirements"]]
        index = ["--no-index"] if environment["no_index"] else []
        pip = ["-m", "pip", "install", "--quiet", "--no-input", "--disable-pip-version-check"]
        for command in (
            [sys.executable, "-m", "venv", str(place)],
            [python, *pip, *index, "--find-links", str(wheels), *packages],
        ):
            succeeded, text = run(command, _INSTALL_LIMIT_S)
            if not succeeded:
                raise RequestFailed(f"the packages could not be installed there: {text}")
        (place / "complete").touch()

    def activate(self, release: str, limit_s: float) -> str:
        """Make a release the current one, and restart the service; go back if that fails."""
        if release not in self.ids():
            known = ", ".join(self.ids()) or "none"
            raise RequestFailed(f"there is no release {release}; releases there: {known}")
        before = self.linked("current")
        self.service.check_rights()
        self.link("current", release)
        active, reason = self.service.restart(limit_s)
        if active:
            if before != release:
                self.link("previous", before)
            return reason
        self.link("current", before)
        failed = f"release {release} did not become active: {reason}"
        if not before:
            raise RequestFailed(f"{failed}\nthere is no earlier release to go back to")
        active, reason = self.service.restart(limit_s)
        state = "" if active else ", which is not active either"
        raise RequestFailed(f"{failed}\nrolled back to release {before}{state}: {reason}")

    def prune(self, keep: int) -> None:
        """Remove all but the newest releases and those in use, and what no release needs."""
        ids = self.ids()
        used = {self.linked("current"), self.linked("previous")}
        for one in ids[: max(0, len(ids) - keep)]:
            if one not in used:
                shutil.rmtree(self.releases / one, ignore_errors=True)
        for place in self.releases.iterdir():
            if not self.described(place.name):  # its push was killed
                shutil.rmtree(place, ignore_errors=True)
        needed = {(self.described(one) or {}).get("environment") for one in self.ids()}
        for place in self.environments.iterdir():
            if place.name not in needed:
                shutil.rmtree(place, ignore_errors=True)


class SystemdService:
    """The service of systemd that runs the current release, if it is installed."""

    def __init__(self, unit: str, current: Path) -> None:
        """`current` is the link to the release that the service should run."""
        self.unit = unit
        self._current = current
        self._options: list[str] = []
        self._installed = False
        for options in ([], ["--user"]):
            command = ["systemctl", *options, "is-enabled", unit]
            if run(command, _SYSTEMD_LIMIT_S) == (True, "enabled"):
                self._options, self._installed = options, True
                break

    def state(self) -> str:
        """Return "active", "failed" and so on; "not installed" or "runs another deployment"."""
        if not self._installed:
            return "not installed"
        shown = self._show("ExecStart")
        if f"{self._current}/" not in shown:
            return "runs another deployment"
        return self._show("ActiveState").partition("=")[2].strip()

    def check_rights(self) -> None:
        """Raise `RequestFailed` if this user may not restart the service."""
        if self.state() in ("not installed", "runs another deployment", "inactive"):
            return
        command = self._privileged("restart")
        if command[0] == "sudo":
            allowed, _ = run(["sudo", "-n", "-l", *command[2:]], _SYSTEMD_LIMIT_S)
            if not allowed:
                user = getpass.getuser()
                program = shutil.which("systemctl")
                raise RequestFailed(
                    f"{user} may not restart {self.unit} there; allow it by a file in "
                    f"/etc/sudoers.d: {user} ALL=(root) NOPASSWD: {program} restart {self.unit}"
                )

    def restart(self, limit_s: float) -> tuple[bool, str]:
        """Restart the service, unless it is stopped; return whether that succeeded, and how."""
        state = self.state()
        if state in ("not installed", "runs another deployment", "inactive"):
            name = self.unit.removesuffix(".service")
            words = {
                "not installed": f"no service {name} is installed",
                "inactive": f"service {name} is stopped, and was not started",
                "runs another deployment": f"service {name} runs another deployment",
            }
            return True, words[state]
        succeeded, text = run(self._privileged("restart"), limit_s)
        state = self.state()
        if succeeded and state == "active":
            return True, f"{self.unit} was restarted and is active"
        journal = ["journalctl", *self._options, "--unit", self.unit, "--lines", "20"]
        _, log = run([*journal, "--no-pager", "--output", "cat"], _SYSTEMD_LIMIT_S)
        return False, f"{self.unit} is {state}: {text}\n{log}".strip()

    def _show(self, name: str) -> str:
        command = ["systemctl", *self._options, "show", self.unit, f"--property={name}"]
        return run(command, _SYSTEMD_LIMIT_S)[1]

    def _privileged(self, verb: str) -> list[str]:
        command = ["systemctl", *self._options, verb, self.unit]
        return command if self._options or os.geteuid() == 0 else ["sudo", "-n", *command]


def unpack(stream: IO[bytes], folder: Path) -> int:
    """Write the regular files of an archive below a folder, refuse others; return their number."""
    folder.mkdir(mode=0o750)
    (folder / "wheels").mkdir()
    count = 0
    try:
        with tarfile.open(fileobj=stream, mode="r|") as archive:
            for member in archive:
                path = PurePosixPath(member.name)
                if not member.isfile() or path.is_absolute() or ".." in path.parts:
                    raise RequestFailed(
                        f"the archive holds {member.name!r}, which is not a plain file"
                    )
                target = folder / path
                target.parent.mkdir(parents=True, exist_ok=True)
                source = archive.extractfile(member)
                assert source is not None  # of a regular file
                with source, target.open("wb") as copy:
                    shutil.copyfileobj(source, copy)
                count += 1
    except tarfile.TarError as error:
        raise RequestFailed(f"the connection was lost before all was copied: {error}") from error
    return count


def run(command: list[str], limit_s: float) -> tuple[bool, str]:
    """Run a program; return whether it succeeded, and the end of what it printed."""
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            timeout=limit_s, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return False, f"{Path(command[0]).name} took longer than {limit_s:g} s"
    except OSError as error:
        return False, f"{command[0]}: {error.strerror}"
    text = done.stdout.decode(errors="replace").strip()
    return done.returncode == 0, text[-_LONGEST_REASON:]


def answer(request: dict[str, Any]) -> dict[str, Any]:
    """Return the answer to a request."""
    robot = ReleaseFolder(request["folder"], request["robot"])
    action = request["action"]
    if action == "state":
        return robot.state()
    if action == "push":
        return {"result": pushed(robot, request)}
    if not robot.folder.is_dir():
        raise RequestFailed(f"there is no folder {robot.folder}; push a release first")
    with robot.locked():
        return {"result": robot.activate(request["release"], request["limit_s"])}


def pushed(robot: ReleaseFolder, request: dict[str, Any]) -> str:
    """Receive a release and activate it; return how."""
    if sys.version_info < _OLDEST_PYTHON and request["environment"]["digest"]:
        raise RequestFailed(f"python3 there is {sys.version.split()[0]}; install 3.11 or later")
    release = request["release"]
    robot.prepare()
    with robot.locked():
        robot.receive(release, request["description"], request["environment"], request["count"])
        try:
            result = robot.activate(release, request["limit_s"])
        except RequestFailed:
            shutil.rmtree(robot.releases / release, ignore_errors=True)
            raise
        robot.prune(request["keep"])
    return result


def main() -> None:
    """Answer the request in the first argument; never end without an answer."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    os.umask(0o027)
    try:
        found = answer(json.loads(sys.argv[1]))
    except RequestFailed as error:
        found = {"error": str(error)}
    except OSError as error:
        found = {"error": f"{error.filename or 'a file'} there: {error.strerror}"}
    with suppress(BrokenPipeError):  # the connection was lost meanwhile
        sys.stdout.write(json.dumps(found))
        sys.stdout.flush()


if __name__ == "__main__":
    main()
