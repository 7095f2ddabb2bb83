"""What the root of a deployment must know of the components' classes: it does not import them.

That saves the root their memory, 150 MiB for the simulated robot, and about a second of processor
time. The plan is made in a process forked from the zygote, which has imported them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from cairn.bus.message_limits import MessageLimits
from cairn.bus.session import Gateway
from cairn.deployment.access_control import access_control
from cairn.deployment.bus_settings import TlsSettings
from cairn.deployment.exclusive_topics import ExclusiveTopic, exclusive_topics
from cairn.deployment.load import SourceDocument, assemble
from cairn.deployment.model import RECORDER, ChildSpec, Deployment, expendable
from cairn.deployment.plugins import load_plugin
from cairn.deployment.shipped import FOLDER
from cairn.deployment.topic_limits import topic_limits
from cairn.errors import CairnError
from cairn.runtime.parameters import ReadPathMark, marked_parameters

_RECORDING = "recording"
"""The supervisor that `--record` adds, above a component named as the plugin `recorder`."""


@dataclass(frozen=True)
class RunPlan:
    """A checked deployment, with what follows from its components' ports and requests.

    `gateway` is that between the network and the deployment; None if it has no such endpoint.
    """

    deployment: Deployment
    exclusive_topics: tuple[ExclusiveTopic, ...]
    topic_limits: MessageLimits
    gateway: Gateway | None


_PLAN = TypeAdapter(RunPlan)
_SOURCES = TypeAdapter(list[SourceDocument])


def plan_run(deployment: Deployment) -> RunPlan:
    """Return the plan of a deployment that `cairn check` accepts."""
    limits = topic_limits(deployment)
    gateway = _gateway_of(deployment, limits)
    return RunPlan(deployment, exclusive_topics(deployment), limits, gateway)


def check_and_plan(
    file: Path,
    sources: Sequence[SourceDocument],
    sets: Sequence[str],
    recording: Path | None = None,
) -> RunPlan:
    """Return the plan of the deployment in a file that was read, with its overlays and `--set`s.

    With `recording`, it is recorded to that file. Raises `CairnError` with everything that is wrong
    with it.
    """
    deployment = check_sources(file, sources, sets)
    return plan_run(deployment if recording is None else with_recorder(deployment, recording))


def check_for_root(argument: Mapping[str, Any]) -> Any:
    """Return `check_and_plan` of file, sources and sets as JSON: the root calls it in a fork."""
    sources = _SOURCES.validate_python(argument["sources"])
    recording = argument["recording"] and Path(argument["recording"])
    plan = check_and_plan(Path(argument["file"]), sources, argument["sets"], recording)
    return _PLAN.dump_python(plan, mode="json")


def argument_of_check(
    file: Path,
    sources: Sequence[SourceDocument],
    sets: Sequence[str],
    recording: Path | None = None,
) -> dict[str, Any]:
    """Return the argument of `check_for_root`, as JSON."""
    documents = _SOURCES.dump_python(list(sources), mode="json")
    return {
        "file": str(file),
        "sources": documents,
        "sets": list(sets),
        "recording": recording and str(recording),
    }


def with_recorder(deployment: Deployment, file: Path) -> Deployment:
    """Return a deployment with a recorder, which starts before its components and stops after them.

    It has a supervisor of its own that nothing depends on: however often the recorder fails, the
    robot continues. Raises `CairnError` if the deployment has a component of such a name.
    """
    names = {member.name for member in deployment.members()}
    if taken := sorted(names & {_RECORDING, RECORDER}):
        raise CairnError(
            f"the deployment has a component {taken[0]} already, a name that --record needs; "
            "start it without --record, or rename that component"
        )
    recorder = ChildSpec(plugin=RECORDER, parameters={"file": str(file)})
    components = {_RECORDING: expendable({RECORDER: recorder}), **deployment.components}
    return deployment.model_copy(update={"components": components})


def plan_of(result: Any) -> RunPlan:
    """Return the plan that `check_for_root` has made."""
    return _PLAN.validate_python(result)


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
