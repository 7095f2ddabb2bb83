"""Two computers of one robot, each with its identity."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from cairn.security.authority import Authority, AuthorityMember
from cairn.security.folder import VARIABLE, RobotFolder
from cairn.testing.launching import Launching, Run, launching
from tests.commands import Answer, cairn
from tests.machines.network import Cable, Computer, missing, two_computers


@dataclass
class Machines:
    """The machines `base` and `brain` of a robot, and the cable between them."""

    base: Computer
    brain: Computer
    cable: Cable
    launch: Launching
    security: Path
    runs: dict[str, Run] = field(default_factory=dict)

    @property
    def keys(self) -> str:
        """The deployment's key `machines`."""
        return (
            f"machines: {{base: {{address: {self.base.address}}}, "
            f"brain: {{address: {self.brain.address}}}}}\n"
        )

    def up(self, machine: str, deployment: str | Path, *arguments: str, **how: Any) -> Run:
        """Run `cairn up` on a machine."""
        computer: Computer = getattr(self, machine)
        run = self.launch(
            deployment,
            "--machine",
            machine,
            *arguments,
            environment={VARIABLE: str(self.security)},
            preexec_fn=computer.enter,
            **how,
        )
        self.runs[machine] = run
        return run

    def cairn(self, machine: str, *arguments: str) -> Answer:
        """Run a command on a machine."""
        return cairn(*arguments, connect=self.runs[machine].endpoint)

    def rows(self, machine: str) -> dict[str, dict[str, Any]]:
        """Return what `cairn ps` shows on a machine, by the component's name."""
        rows = self.cairn(machine, "ps", "--json").json
        return {row["component"].rpartition("/")[2]: row for row in rows}


@pytest.fixture
def machines(tmp_path: Path) -> Iterator[Machines]:
    """Give two computers that are cabled, with identities of robot `robot`."""
    if reason := missing():
        pytest.skip(reason)
    with two_machines(tmp_path) as made:
        yield made


@contextmanager
def two_machines(folder: Path) -> Iterator[Machines]:
    """Yield two computers that are cabled, whose identities and reports are in this folder."""
    security = folder / "security"
    with (
        pytest.MonkeyPatch.context() as patch,
        two_computers() as (base, brain, cable),
        launching(folder) as launch,
    ):
        patch.setenv(VARIABLE, str(security))
        members = [
            AuthorityMember("base", None, (base.address,)),
            AuthorityMember("brain", None, (brain.address,)),
        ]
        Authority.create(RobotFolder.of("robot"), members)
        yield Machines(base, brain, cable, launch, security)
