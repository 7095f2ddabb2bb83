"""Push a release to a machine, list the releases there, and go back to an earlier one."""

from __future__ import annotations

import io
import ipaddress
import socket
import tarfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import blake2b
from pathlib import Path
from typing import IO, Any, Final

import psutil

from cairn.cli.releases.contents import Contents
from cairn.cli.releases.packages import Packages
from cairn.cli.releases.ssh import Host
from cairn.deployment.model import Deployment
from cairn.errors import CairnError

_FILE_MODE: Final = 0o640


@dataclass(frozen=True)
class Target:
    """One machine to which releases are pushed: its name, "" for a robot's only one, and host."""

    machine: str
    host: Host
    folder: str
    robot: str

    @property
    def label(self) -> str:
        """How messages name the machine."""
        return self.machine or self.host.destination

    def request(
        self,
        action: str,
        write: Callable[[IO[bytes]], None] | None = None,
        **arguments: Any,
    ) -> dict[str, Any]:
        """Make a request of the machine about this robot; raises `CairnError`."""
        request = {"action": action, "folder": self.folder, "robot": self.robot, **arguments}
        try:
            return self.host.request(request, write)
        except CairnError as error:
            raise CairnError(f"{self.label}: {error}") from error


@dataclass(frozen=True)
class Pushed:
    """What is pushed: contents, and packages or the path of an environment on the machine."""

    contents: Contents
    packages: Packages | None
    environment: str = ""

    @property
    def digest(self) -> str:
        """One of everything that the release holds."""
        packages = self.environment if self.packages is None else self.packages.digest
        return blake2b(f"{self.contents.digest} {packages}".encode(), digest_size=16).hexdigest()


def push(
    target: Target, pushed: Pushed, *, keep: int, limit_s: float, report: Callable[[str], None]
) -> str:
    """Bring a release to a machine and activate it; return the result in words.

    What is there already is not copied again. Raises `CairnError` if it does not become active; the
    release before is then active again.
    """
    state = target.request("state")
    known = {one["digest"]: one["id"] for one in state["releases"]}
    packages, digest = pushed.packages, pushed.digest
    if known.get(digest, "") == state["current"] != "":
        return f"unchanged: release {state['current']}; service {state['service']}"
    if digest in known:
        report(f"release {known[digest]} is there already")
        answer = target.request("activate", release=known[digest], limit_s=limit_s)
        return f"release {known[digest]} is current; {answer['result']}"
    now = datetime.now(UTC)
    release = f"{now:%Y%m%d-%H%M%S}-{digest[:8]}"
    contents = pushed.contents
    wheels: tuple[Path, ...] = ()
    if packages is not None and packages.digest not in state["environments"]:
        wheels = packages.wheels
        report(f"installing {', '.join(packages.names())}: may take minutes")
    report(f"copying {len(contents.files) + 1} files ({contents.size / 1e6:.1f} MB)")
    answer = target.request(
        "push",
        lambda stream: _write(stream, contents, wheels),
        release=release,
        count=1 + len(contents.files) + len(wheels),
        description={
            "digest": digest,
            "created": now.isoformat(timespec="seconds"),
            "by": socket.gethostname(),
            "files": len(contents.files),
            "packages": [] if packages is None else packages.names(),
        },
        environment={
            "digest": "" if packages is None else packages.digest,
            "path": pushed.environment,
            "requirements": [] if packages is None else [packages.cairn, *packages.requirements],
            "no_index": packages is not None and packages.no_index,
        },
        keep=keep,
        limit_s=limit_s,
    )
    if state["service"] == "not installed":
        current = f"{state['folder']}/current"
        named = f" --machine {target.machine}" if target.machine else ""
        report(
            f"to run it at each boot, on that machine: sudo {current}/environment/bin/cairn "
            f"service install {current}/{contents.name}{named}"
        )
    return f"release {release} is current; {answer['result']}"


def roll_back(target: Target, release: str, *, limit_s: float) -> str:
    """Activate an earlier release, "" for the one before; return the result in words."""
    if not release:
        release = target.request("state")["previous"]
        if not release:
            raise CairnError(f"{target.label}: there is no release before the current one")
    answer = target.request("activate", release=release, limit_s=limit_s)
    return f"release {release} is current; {answer['result']}"


def targets(
    deployment: Deployment, machines: list[str], to: str, folder: str, config: Path | None
) -> Iterator[Target]:
    """Yield the named machines, by default all but this computer; raises `CairnError`."""
    known: Mapping[str, Any] = deployment.machines
    if unknown := [one for one in machines if one not in known]:
        raise CairnError(
            f"there is no machine {unknown[0]}; the deployment has: {', '.join(known)}"
        )
    if not known and not to:
        raise CairnError(
            "the deployment has no `machines`: name the computer with --to [USER@]HOST"
        )
    if to and len(known) > 1 and len(machines) != 1:
        raise CairnError("--to: name the one machine that it is with --machine")
    folder = folder or f"/srv/cairn/{deployment.robot.name}"
    if to:
        machine = next(iter(machines or known), "")
        yield Target(machine, Host(to, config), folder, deployment.robot.name)
        return
    chosen = machines or [
        name for name, one in deployment.machines.items() if not is_this_computer(one.address)
    ]
    if not chosen:
        raise CairnError("all machines are this computer; name one with --machine")
    for name in chosen:
        host = Host(deployment.machines[name].address, config)
        yield Target(name, host, folder, deployment.robot.name)


def is_this_computer(address: str) -> bool:
    """Return whether an address, or a host name, is one of this computer's."""
    try:
        found = socket.getaddrinfo(address, None, type=socket.SOCK_DGRAM)
    except OSError:
        return False  # ssh reports it
    own = {one.address.partition("%")[0] for card in psutil.net_if_addrs().values() for one in card}
    addresses = [str(place[0]).partition("%")[0] for *_, place in found]
    return any(one in own or ipaddress.ip_address(one).is_loopback for one in addresses)


def _write(stream: IO[bytes], contents: Contents, wheels: tuple[Path, ...]) -> None:
    """Write an archive of a release's files, and of wheels."""
    with tarfile.open(fileobj=stream, mode="w|") as archive:
        _add(archive, f"release/{contents.name}", io.BytesIO(contents.text.encode()))
        for name, path in contents.files.items():
            with path.open("rb") as file:
                _add(archive, f"release/{name}", file)
        for wheel in wheels:
            with wheel.open("rb") as file:
                _add(archive, f"wheels/{wheel.name}", file)


def _add(archive: tarfile.TarFile, name: str, file: IO[bytes]) -> None:
    entry = tarfile.TarInfo(name)
    entry.mode = _FILE_MODE
    entry.size = file.seek(0, io.SEEK_END)
    file.seek(0)
    archive.addfile(entry, file)
