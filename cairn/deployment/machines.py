"""A robot of several machines: which component runs where, and what crosses between them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping

from pydantic import BaseModel, ConfigDict

from cairn.bus.bus import full_name
from cairn.deployment.exclusive_topics import ports_in
from cairn.deployment.model import RECORDER, Deployment, root_name, view_name
from cairn.deployment.problems import Problem, suggestion
from cairn.deployment.yaml_document import DocumentNode, KeyPath, component_nodes, dotted
from cairn.errors import CairnError
from cairn.schemas.cairn_msgs import MACHINE_STATUS


class RemoteInput(BaseModel):
    """A topic that components of one machine publish and those of another one read."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    topic: str
    writer: str
    writer_machine: str
    readers: tuple[str, ...]
    reader_machine: str
    has_other_writers: bool = False
    """Whether components of another machine than the writer's publish it, too."""

    def __str__(self) -> str:
        return f"{self.topic} ({self.writer}) for {', '.join(self.readers)}"


def check_machine(deployment: Deployment, machine: str, file: str) -> None:
    """Raise `CairnError` unless a deployment can run on that machine; "" for its only one."""
    named = ", ".join(deployment.machines)
    if machine and machine not in deployment.machines:
        one_of = f"choose one of: {named}" if named else "it has no `machines`; leave it out"
        raise CairnError(f"{file}: there is no machine {machine}; {one_of}")
    if deployment.machines and not machine:
        raise CairnError(
            f"{file} runs on several machines; name this one with --machine, one of: {named}"
        )


def components_by_machine(deployment: Deployment) -> dict[str, tuple[str, ...]]:
    """Return the names of the components of each machine, in start order."""
    found: dict[str, list[str]] = {machine: [] for machine in deployment.machines}
    for member in deployment.members():
        found[deployment.machine_of(member.name)].append(member.name)
    return {machine: tuple(names) for machine, names in found.items()}


def machine_status_topic(robot: str, machine: str, main_machine: str) -> str:
    """Return the topic (full name) on which the root of a machine publishes its status.

    It lies below the name of that root, so no other machine may publish on it: see
    `machine_access`.
    """
    return full_name(robot, f"{root_name(machine, main_machine)}/{MACHINE_STATUS}")


def parents_elsewhere(deployment: Deployment, machine: str) -> dict[str, str]:
    """Return the parent of each component of a machine whose parent runs on another one."""
    parents = {}
    for member in deployment.members():
        above = member.parent and deployment.machine_of(member.parent)
        above = above or deployment.main_machine
        if deployment.machine_of(member.name) == machine != above:
            parents[member.name] = member.parent or root_name(above, deployment.main_machine)
    return parents


def remote_inputs(deployment: Deployment) -> tuple[RemoteInput, ...]:
    """Return what crosses between the machines, sorted by topic.

    A component whose plugin cannot be loaded is left out: its own start reports why.
    """
    writers: defaultdict[str, list[str]] = defaultdict(list)
    readers: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for member, topic, port in ports_in(deployment):
        if port.direction == "out":
            writers[topic].append(member.name)
        else:
            readers[topic, deployment.machine_of(member.name)].append(member.name)
    return tuple(
        RemoteInput(
            topic=topic,
            writer=writer,
            writer_machine=deployment.machine_of(writer),
            readers=tuple(names),
            reader_machine=machine,
            has_other_writers=len({deployment.machine_of(one) for one in writers[topic]}) > 1,
        )
        for (topic, machine), names in sorted(readers.items())
        for writer in writers[topic]
        if deployment.machine_of(writer) != machine
    )


def published_elsewhere(inputs: Iterable[RemoteInput], machine: str) -> dict[str, str]:
    """Return each topic that a machine reads and only one other machine publishes, with that."""
    return {
        one.topic: one.writer_machine
        for one in inputs
        if one.reader_machine == machine and not one.has_other_writers
    }


def machine_problems(root: DocumentNode) -> Iterator[Problem]:
    """Yield what is wrong with the machines of a deployment, and with what runs on them."""
    section = root.find("machines")
    known = [] if section is None else list(section.entries)
    main = known[0] if known else ""
    reserved = {name(machine, main) for machine in known[1:] for name in (root_name, view_name)}
    if section is not None:
        yield from _bus_problems(root, section)
        yield from _address_problems(section)
    machines: dict[KeyPath, str] = {}
    for name, path, node in component_nodes(root):
        own = node.find("machine")
        above = machines.get(path[:-2], main)
        machine = own.value if own is not None and isinstance(own.value, str) else above
        machines[path] = machine
        if own is not None and isinstance(own.value, str) and own.value not in known:
            found = f"there is no machine {own.value}"
            remedy = (
                suggestion(own.value, known)
                if known
                else "add it: `machines: {NAME: {address: HOST}}`"
            )
            yield Problem(own.where, dotted((*path, "machine")), found, remedy)
            continue
        at = node.key_at or node.at
        if name in reserved:
            found = f"{name} is a name that a robot of several machines has already"
            yield Problem(at, dotted(path), found, "give it another name")
        yield from _placement_problems(path, node, moved=machine != above, local=machine == main)
        plugin = node.find("plugin")
        if plugin is not None and plugin.value == RECORDER and machine not in ("", main):
            role = section and section.find(machine, "role")
            if role is None:
                found = f"machine {machine} may not read the topics of the others"
                remedy = f"add `role: view` to machines.{machine}, or run the recorder on {main}"
                yield Problem(plugin.where, dotted(path), found, remedy)


def _placement_problems(
    path: KeyPath, node: DocumentNode, *, moved: bool, local: bool
) -> Iterator[Problem]:
    """Yield which keys of a component do not fit its machine."""
    placement, loss = node.find("placement"), node.find("on_loss")
    significant, fallback = node.find("significant"), node.find("fallback")
    if fallback is not None and fallback.value is not None and not moved:
        found = "it runs on its parent's machine, to which there is no link"
        remedy = "remove it, or add `machine`"
        yield Problem(fallback.where, dotted((*path, "fallback")), found, remedy)
    if moved and placement is not None and placement.value == "in_process":
        found = "a component in its parent's process runs on its parent's machine"
        remedy = "use placement: process, or remove `machine`"
        yield Problem(placement.where, dotted((*path, "placement")), found, remedy)
    if loss is not None and not moved:
        found = "it runs on its parent's machine, which cannot be lost"
        remedy = "remove it, or add `machine`"
        yield Problem(loss.where, dotted((*path, "on_loss")), found, remedy)
    if significant is not None and significant.value is True and not local:
        found = "only a component of the first machine can end the deployment"
        remedy = "remove it, or run the component there"
        yield Problem(significant.where, dotted((*path, "significant")), found, remedy)


def _bus_problems(root: DocumentNode, section: DocumentNode) -> Iterator[Problem]:
    connect = root.find("bus", "connect")
    if connect is not None and connect.value and section.entries:
        found = "a robot of several machines has a router on each of them, and joins no other one"
        yield Problem(connect.where, "bus.connect", found, "remove it, or remove `machines`")


def _address_problems(section: DocumentNode) -> Iterator[Problem]:
    first: dict[tuple[object, object], str] = {}
    for name, node in section.entries.items():
        values = node.plain()
        if not isinstance(values, Mapping):
            continue  # reported as invalid
        address = values.get("address"), values.get("port")
        if address in first:
            found = f"it has the address and port of machine {first[address]}"
            yield Problem(node.where, dotted(("machines", name)), found, "give it its own")
        first.setdefault(address, name)
