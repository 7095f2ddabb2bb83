"""What the root of a deployment must know of the components' classes: it does not import them.

That saves the root their memory, 150 MiB for the simulated robot, and about a second of processor
time. The plan is made in a process forked from the zygote, which has imported them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from cairn.bus.exclusive import ExclusiveTopic
from cairn.bus.message_limits import MessageLimits
from cairn.bus.session import Gateway
from cairn.deployment.access_control import access_control
from cairn.deployment.bus_settings import TlsSettings
from cairn.deployment.exclusive_topics import exclusive_topics
from cairn.deployment.load import SourceDocument, assemble
from cairn.deployment.machine_access import machine_access
from cairn.deployment.machines import (
    RemoteInput,
    check_machine,
    parents_elsewhere,
    remote_inputs,
)
from cairn.deployment.model import RECORDER, Deployment, expendable
from cairn.deployment.plugins import load_plugin
from cairn.deployment.shipped import FOLDER
from cairn.deployment.topic_limits import topic_limits
from cairn.errors import CairnError
from cairn.processes.certified_router import gateway_for_operators, machine_links
from cairn.runtime.child_spec import ChildSpec
from cairn.runtime.parameters import ReadPathMark, marked_parameters

_RECORDING = "recording"
"""The supervisor that `--record` adds, above a component named as the plugin `recorder`."""


@dataclass(frozen=True)
class RunPlan:
    """A checked deployment, with what follows from its components' ports and requests.

    `gateway` is that between the network and the deployment; None if it has no such endpoint.
    `machine` is the one that the plan is for, `machine_access` what the others may do here,
    `remote_inputs` what crosses, and `added` names the supervisor that is on this machine alone, as
    its `cairn up` records; all empty for a robot with one computer.
    """

    deployment: Deployment
    exclusive_topics: tuple[ExclusiveTopic, ...]
    topic_limits: MessageLimits
    gateway: Gateway | None
    machine: str = ""
    machine_access: Mapping[str, Any] = field(default_factory=dict)
    remote_inputs: tuple[RemoteInput, ...] = ()
    added: tuple[str, ...] = ()

    def root(self) -> ChildSpec:
        """Return the root of the tree on this machine."""
        root = self.deployment.root(self.machine)
        children = {
            name: one.model_copy(update={"load": "at_start"}) if name in self.added else one
            for name, one in root.children.items()
        }
        return root.model_copy(update={"children": children})

    def parents(self) -> dict[str, str]:
        """Return the parent of each component here that a parent on another machine loads."""
        if not self.machine:
            return {}
        found = parents_elsewhere(self.deployment, self.machine)
        return {name: parent for name, parent in found.items() if name not in self.added}


@dataclass(frozen=True)
class PlanRequest:
    """What is to be checked and planned: the deployment in a file that was read.

    `sources` are the file and its overlays, `sets` the `--set`s. With `recording`, it is recorded
    to that file, on `machine`.
    """

    file: Path
    sources: list[SourceDocument]
    sets: list[str]
    recording: Path | None = None
    machine: str = ""


PLAN = TypeAdapter(RunPlan)
"""Converts a plan to JSON and back."""

REQUEST = TypeAdapter(PlanRequest)
"""Converts a request to JSON and back."""


def plan_run(deployment: Deployment, machine: str = "") -> RunPlan:
    """Return the plan of a deployment that `cairn check` accepts, for one of its machines.

    Raises `CairnError` if the machine has no identity that the others accept, or the one of
    `bus.tls` is not in force.
    """
    limits = topic_limits(deployment)
    gateway = _gateway_of(deployment, limits) if machine == deployment.main_machine else None
    exclusive = exclusive_topics(deployment)
    tls = deployment.bus.tls
    if gateway is not None and tls is not None and tls.identity is not None:
        gateway_for_operators(
            gateway, deployment.robot.name, tls.identity
        )  # to report what is wrong
    if not machine:
        return RunPlan(deployment, exclusive, limits, gateway)
    access = machine_access(deployment, machine)
    machine_links(deployment, machine, access)  # to report what is wrong before anything starts
    inputs = remote_inputs(deployment)
    return RunPlan(deployment, exclusive, limits, gateway, machine, access, inputs)


def check_and_plan(request: PlanRequest) -> RunPlan:
    """Return the plan of a deployment; raises `CairnError` with all that is wrong with it."""
    machine = request.machine
    deployment = check_sources(request.file, request.sources, request.sets)
    check_machine(deployment, machine, request.file.name)
    if request.recording is None:
        return plan_run(deployment, machine)
    plan = plan_run(with_recorder(deployment, request.recording, machine), machine)
    return replace(plan, added=(_RECORDING,))


def check_for_root(request: Any) -> Any:
    """Return `check_and_plan` of a request, both as JSON: the root calls it in a fork."""
    return PLAN.dump_python(check_and_plan(REQUEST.validate_python(request)), mode="json")


def with_recorder(deployment: Deployment, file: Path, machine: str = "") -> Deployment:
    """Return a deployment with a recorder, which starts before its components and stops after them.

    It runs on `machine`, by default the first one.

    It has a supervisor of its own that nothing depends on: however often the recorder fails, the
    robot continues. Raises `CairnError` if the deployment has a component of such a name, or the
    machine may not read the topics of the others.
    """
    if machine and deployment.role_of(machine) is None:
        raise CairnError(
            f"machine {machine} may not read the topics of the other machines, which --record "
            f"needs; add `role: view` to machines.{machine} in the deployment, or record on "
            f"{deployment.main_machine}"
        )
    names = {member.name for member in deployment.members()}
    if taken := sorted(names & {_RECORDING, RECORDER}):
        raise CairnError(
            f"the deployment has a component {taken[0]} already, a name that --record needs; "
            "start it without --record, or rename that component"
        )
    recorder = ChildSpec(plugin=RECORDER, parameters={"file": str(file)})
    recording = expendable({RECORDER: recorder})
    if machine and machine != deployment.main_machine:
        recording = recording.model_copy(update={"machine": machine, "placement": "process"})
    components = {_RECORDING: recording, **deployment.components}
    return deployment.model_copy(update={"components": components})


def check_sources(file: Path, sources: Sequence[SourceDocument], sets: Sequence[str]) -> Deployment:
    """Return the deployment in a file that was read; otherwise as `check_and_plan`."""
    deployment = assemble(sources, sets)
    if file.parent == FOLDER:
        _check_recordings(file, deployment)
    return deployment


def _gateway_of(deployment: Deployment, limits: MessageLimits) -> Gateway | None:
    """Return the gateway between the network and a deployment; None if it has no such endpoint."""
    bus = deployment.bus
    if bus.allow_any_local_user or not bus.listen:
        return None
    tls = bus.tls or TlsSettings()
    return Gateway(
        listen=bus.listen,
        access_control=access_control(deployment),
        password_files={name: user.password_file for name, user in bus.users.items()},
        certificate=tls.certificate,
        key=tls.key,
        ca=tls.ca,
        client_certificates=tls.client_certificates,
        limits=limits,
    )


def _check_recordings(file: Path, deployment: Deployment) -> None:
    """Raise `CairnError` if a shipped deployment reads a recording that is not shipped with it."""
    for member in deployment.members():
        config = load_plugin(member.spec.plugin).config_class()
        values = config.model_validate(member.spec.parameters)
        for read in marked_parameters(values, ReadPathMark):
            path = Path(read.value)
            if not path.exists() and path.resolve().is_relative_to(FOLDER.parent):
                raise CairnError(
                    f"{file.name}: {member.name}.{read.name}: {path} is not part of the installed "
                    f"package; name your own with --set, as the comment in {file} explains"
                )
