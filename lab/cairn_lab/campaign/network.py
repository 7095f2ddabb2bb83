"""The machines of a deployment, all on this computer, and the links between them.

Each machine has its own `cairn up --machine`. It is given the address of its own router, and in
place of those of the other machines the links to them. All have identities of an authority that
exists only as long as the network.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType

from cairn.deployment.model import Deployment
from cairn.security.authority import Authority, AuthorityMember
from cairn.security.folder import VARIABLE, RobotFolder
from cairn.testing.launching import free_port
from cairn_lab.campaign.link import HOST, Link


class Network:
    """The links between the machines of a deployment; a context manager, which ends them.

    A deployment without machines has one, "", and no links.
    """

    def __init__(self, deployment: Deployment) -> None:
        """Take the machines; nothing is opened yet."""
        self.machines: tuple[str, ...] = tuple(deployment.machines) or ("",)
        """In the order of the deployment: the first is its main machine."""
        self.links: dict[str, Link] = {}
        """Those between two machines each, named `FIRST-SECOND`."""
        self.environment: Mapping[str, str] = {}
        """Environment variables for each `cairn up`."""
        self._robot = deployment.robot.name
        self._ports: dict[str, int] = {}
        self._closing = ExitStack()

    def __enter__(self) -> Network:
        """Open the links; raises `CairnError` if that is impossible."""
        if len(self.machines) > 1:
            with ExitStack() as stack:
                self._open(stack)
                self._closing = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the links, and remove the identities."""
        self._closing.close()

    def arguments(self, machine: str) -> list[str]:
        """Return the arguments with which `cairn up` runs a machine here."""
        if not machine:
            return []
        words = ["--machine", machine]
        for other in self.machines:
            # Each machine connects to those before it, so only their ports matter to it.
            link = self.links.get(f"{other}-{machine}")
            port = self._ports[other] if link is None else link.port
            words += ["--set", f"machines.{other}.address={HOST}"]
            words += ["--set", f"machines.{other}.port={port}"]
        return words

    def _open(self, stack: ExitStack) -> None:
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="cairn-campaign-")))
        members = [AuthorityMember(machine, None, (HOST,)) for machine in self.machines]
        Authority.create(RobotFolder(self._robot, folder / self._robot), members)
        self.environment = {VARIABLE: str(folder)}
        self._ports = {machine: free_port() for machine in self.machines}
        for number, second in enumerate(self.machines):
            for first in self.machines[:number]:
                name = f"{first}-{second}"
                self.links[name] = Link(name, free_port(), self._ports[first])
                stack.callback(self.links[name].close)
