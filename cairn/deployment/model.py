"""The deployment format: a tree of components, each with where and how it runs."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from cairn.bus.endpoints import MAX_DOMAIN, default_domain
from cairn.bus.keys import ROS_NAMES
from cairn.bus.roles import Role
from cairn.deployment.bus_settings import BusSettings
from cairn.tf.robot_frames import BASE_FRAME
from cairn.tf.transform import Transform
from cairn.tf.urdf import Joint

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
Topic = Annotated[str, Field(pattern=r"^/?[a-zA-Z_][a-zA-Z0-9_]*(/[a-zA-Z_][a-zA-Z0-9_]*)*$")]
FrameName = Annotated[str, Field(pattern=r"^[a-zA-Z_][a-zA-Z0-9_]*$")]
Meters = Annotated[float, Field(ge=-5, le=5, allow_inf_nan=False)]
Seconds = Annotated[float, Field(gt=0, le=3600, allow_inf_nan=False)]
Restart = Literal["permanent", "transient", "temporary"]
Strategy = Literal["one_for_one", "rest_for_one", "one_for_all"]
LogLevel = Literal["debug", "info", "warning", "error"]
OnLoss = Literal["stop", "degrade", "ignore"]

ROOT = "root"
VIEW = "cairn_up"
RECORDER = "recorder"
"""The plugin that records the bus."""
ALL_TOPICS = "/**"
"""What a recorder records unless its parameter `topics` says otherwise."""
ROBOT_FRAMES = "robot_frames"
"""The component that publishes the robot's frames, and its plugin."""
_ROS = "ros"
"""The supervisor of that component."""
_ROOT_PLUGIN = "cairn.processes.supervisor:Supervisor"
RESERVED = {
    ROOT: "the root of the tree of components",
    VIEW: "the node with which `cairn up` listens",
    ROBOT_FRAMES: "the component that publishes the robot's frames",
    ROS_NAMES: "the component that gives topics their ROS names",
    _ROS: "the supervisor of ros_names",
}
"""Names of nodes that every deployment has, which no component may use."""

_KILL_S = 3.0
"""Time [s] allowed for killing a child that did not stop in time."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, validate_default=True)


class Supervision(_Section):
    """What a supervisor does when one of its children dies (Erlang/OTP's semantics)."""

    strategy: Strategy = Field(
        "one_for_one",
        description="What to restart: the child, also those started after it, or all children.",
    )
    max_restarts: int = Field(
        3, ge=0, le=1000, description="Restarts allowed within `within_s`; one more escalates."
    )
    within_s: Seconds = Field(10.0, description="Window in which restarts are counted [s].")


class Storage(_Section):
    """Limits on what a deployment writes to the disk."""

    max_log_size: int = Field(
        10_000_000,
        ge=10_000,
        le=10_000_000_000,
        description="A longer log file is renamed to FILE.1, and a new one is started [bytes].",
    )
    old_logs: int = Field(
        2, ge=1, le=100, description="Older log files kept of each process: FILE.1, FILE.2 ..."
    )
    kept_runs: int = Field(
        20,
        ge=1,
        le=10_000,
        description="Run folders kept complete; older ones keep maps and results only.",
    )
    max_runs_size: int = Field(
        10_000_000_000,
        ge=1_000_000,
        le=1_000_000_000_000_000,
        description="Size of all run folders [bytes]; beyond it fewer are kept complete.",
    )


class Frame(_Section):
    """Where a frame is mounted on the robot, level: x ahead, y to the left, z up."""

    parent: str = Field(
        BASE_FRAME, min_length=1, description="Frame that it is mounted on, by default the base."
    )
    x: Meters = Field(0.0, description="Ahead of the parent's origin [m].")
    y: Meters = Field(0.0, description="Left of it [m].")
    z: Meters = Field(0.0, description="Above it [m].")
    theta: float = Field(
        0.0,
        ge=-math.pi,
        le=math.pi,
        allow_inf_nan=False,
        description="Turned to the left [rad].",
    )

    def joint(self, name: str) -> Joint:
        """Return the joint between the parent and this frame, which has that name."""
        rotation = (0.0, 0.0, math.sin(self.theta / 2), math.cos(self.theta / 2))
        pose = Transform((self.x, self.y, self.z), rotation)
        return Joint(f"{name}_mount", "fixed", self.parent, name, pose)


class Fallback(_Section):
    """What runs on the parent's machine instead of a component, while its link is slow or down."""

    plugin: str | None = Field(
        None, description="Plugin of the fallback; by default that of the component."
    )
    parameters: dict[str, Any] = Field(
        default_factory=dict, description="Parameters in which it differs from the component."
    )
    max_round_trip_s: float = Field(
        0.5,
        gt=0,
        le=60,
        allow_inf_nan=False,
        description="The link is slow if there and back takes longer [s].",
    )


class ChildSpec(_Section):
    """One component of the tree, as its supervisor starts, watches and restarts it."""

    plugin: str = Field(
        description="Entry point of group cairn.components, or package.module:Class."
    )
    parameters: dict[str, Any] = Field(
        default_factory=dict, description="Values for the plugin's Config."
    )
    topics: dict[str, Topic] = Field(
        default_factory=dict,
        description="Topic of a port, below /<robot>/ unless it begins with /.",
    )
    max_age_s: dict[str, Seconds] = Field(
        default_factory=dict,
        description="Age from which an input is stale, by port [s]; by default that of its class.",
    )
    placement: Literal["process", "in_process"] = Field(
        "process", description="In a process of its own, or in that of its parent."
    )
    interpreter: Literal["shared", "fresh"] = Field(
        "shared", description="Forked from the zygote, or in a Python interpreter of its own."
    )
    restart: Restart = Field(
        "permanent",
        description="Restarted always, only after an abnormal end (transient), or never.",
    )
    significant: bool = Field(False, description="Its normal end ends the deployment.")
    start_timeout_s: Seconds = Field(60.0, description="Limit for becoming active [s].")
    stop_timeout_s: Seconds = Field(
        5.0, description="Limit for stopping [s]; then its process is killed."
    )
    hang_timeout_s: Seconds = Field(
        5.0, description="Limit for one handler [s]; then it counts as hung and is killed."
    )
    memory_max_mib: int = Field(
        1024,
        ge=256,
        le=1 << 20,
        description="Memory of its process [MiB]; with more, it is killed and restarted.",
    )
    log_level: LogLevel | None = Field(
        None, description="Lowest level of what it logs; by default that of the deployment."
    )
    load: Literal["at_start", "on_request"] = Field(
        "at_start", description="Started with its parent, or when its parent or `cairn load` asks."
    )
    supervision: Supervision = Field(
        default_factory=Supervision, description="For its children; supervisors only."
    )
    children: dict[Name, "ChildSpec"] = Field(
        default_factory=dict, description="Its components in start order; supervisors only."
    )
    machine: Name | None = Field(
        None,
        description="Machine that it runs on, with all below it; by default that of its parent.",
    )
    on_loss: OnLoss = Field(
        "degrade",
        description="What its parent does when it runs on another machine that is lost: stop as "
        "after a failure, go on without it, or go on and log nothing.",
    )
    fallback: Fallback | None = Field(
        None,
        description="What runs on its parent's machine instead, while the link to its own is slow "
        "or down.",
    )

    @property
    def ends_supervisor(self) -> bool:
        """Whether its normal end ends its supervisor normally, and so on up to the deployment.

        This includes supervisors with something significant below them: only that can bring about
        their normal end, and they pass it on.
        """
        return self.significant or self._passes_end_on

    @property
    def restart_type(self) -> Restart:
        """When it is restarted: a supervisor that passes a normal end on is not `permanent`."""
        return "transient" if self._passes_end_on and self.restart == "permanent" else self.restart

    @property
    def start_limit_s(self) -> float:
        """The time [s] it may take to become active, with the children that it starts in turn."""
        children = (child for child in self.children.values() if child.load == "at_start")
        return self.start_timeout_s + sum(child.start_limit_s for child in children)

    @property
    def stop_limit_s(self) -> float:
        """The time [s] it may take to stop, with the children that it stops in turn."""
        children = self.children.values()
        return self.stop_timeout_s + sum(child.stop_limit_s + _KILL_S for child in children)

    @property
    def components(self) -> int:
        """The number of components in this part of the tree, this one included."""
        return 1 + sum(child.components for child in self.children.values())

    @property
    def handler_limit_s(self) -> float:
        """The time [s] one handler may take before the component counts as hung.

        A supervisor may be busy with one of its children meanwhile.
        """
        children = self.children.values()
        steps = (max(child.start_limit_s, child.stop_limit_s) for child in children)
        return self.hang_timeout_s + max(steps, default=0.0)

    @property
    def _passes_end_on(self) -> bool:
        return any(child.ends_supervisor for child in self.children.values())


@dataclass(frozen=True)
class Member:
    """A component with its position in the tree; `parent` is None directly below the root.

    `key` is its path in the deployment, as `--set` takes it: `components.mobile.children.base`.
    """

    name: str
    parent: str | None
    spec: ChildSpec
    key: str


class Machine(_Section):
    """A computer of the robot, as the others reach it."""

    address: str = Field(
        pattern=r"^[A-Za-z0-9]([A-Za-z0-9.-]*[A-Za-z0-9])?$|^[0-9A-Fa-f:]*:[0-9A-Fa-f:.]*$",
        max_length=253,
        description="Host name or IP address at which the other machines reach it.",
    )
    port: int = Field(7448, ge=1, le=65535, description="Port for the links of other machines.")
    role: Role | None = Field(
        None,
        description="What its users may do on the other machines, by commands, recordings and the "
        "console: view, operate or administer. Without one, its components work and `cairn ps` "
        "shows all. The first machine has `administer` unless it names another one.",
    )

    @property
    def endpoint(self) -> str:
        """The endpoint of its router for the other machines, as Zenoh writes it."""
        host = f"[{self.address}]" if ":" in self.address else self.address
        return f"tls/{host}:{self.port}"


class Deployment(_Section):
    """A whole deployment of a robot: the tree of components, their bus and their clock."""

    cairn: Literal[1] = Field(description="Version of this format.")
    robot: Name = Field("robot", description="Namespace of every name on the bus.")
    domain: int = Field(
        default_factory=default_domain,
        ge=0,
        le=MAX_DOMAIN,
        description="Domain; robots communicate only within one. Default: ROS_DOMAIN_ID, or 0.",
    )
    bus: BusSettings = Field(
        default_factory=BusSettings, description="How the components connect to each other."
    )
    clock: Literal["system", "simulated"] = Field(
        "system", description="System time, or the time on topic `clock`."
    )
    call_log: bool | None = Field(
        None,
        description="Whether each component publishes what it is called with on topic "
        "NAME/call_log, so that a recording of it can be re-run exactly; by default if a recorder "
        "in the deployment records all topics.",
    )
    settings: dict[str, Any] = Field(
        default_factory=dict,
        description="Values that `${name}` refers to and `--set name=value` changes.",
    )
    frames: dict[FrameName, Frame] = Field(
        default_factory=dict,
        description="Mounts of the robot's sensors, which `${frames.NAME}` refers to.",
    )
    robot_description: str | None = Field(
        None,
        min_length=1,
        description="File with a robot description (URDF), whose links are frames, too.",
    )
    ros_names: bool = Field(
        False,
        description="Whether topics, services and actions also have their names without the "
        "robot's: /tf, /scan, /navigate_to_pose.",
    )
    external_topics: tuple[Topic, ...] = Field(
        (), strict=False, description="Topics published by programs outside the deployment."
    )
    external_services: tuple[Topic, ...] = Field(
        (),
        strict=False,
        description="Services and actions that programs outside the deployment provide.",
    )
    stop_limit_s: float = Field(
        10.0,
        ge=2,
        le=3600,
        allow_inf_nan=False,
        description="Limit for stopping everything [s], shared out; what hangs is killed.",
    )
    log_level: LogLevel = Field("info", description="Lowest level of what components log.")
    storage: Storage = Field(
        default_factory=Storage, description="Limits of log files and run folders."
    )
    supervision: Supervision = Field(
        default_factory=Supervision, description="For the components directly below the root."
    )
    machines: dict[Name, Machine] = Field(
        default_factory=dict,
        max_length=32,
        description="The robot's computers, if it has several. Components that name none run on "
        "the first.",
    )
    clock_tolerance_s: float = Field(
        0.1,
        gt=0,
        le=10,
        allow_inf_nan=False,
        description="Largest difference between the clocks of two machines [s]: with more, inputs "
        "refuse what the other one publishes with a stamp.",
    )
    components: dict[Name, ChildSpec] = Field(
        min_length=1, description="The components in start order."
    )

    @property
    def has_call_log(self) -> bool:
        """Whether each component publishes its call log: see `call_log`."""
        if self.call_log is not None:
            return self.call_log
        return any(_records_all_topics(member.spec) for member in self.members())

    @property
    def main_machine(self) -> str:
        """The machine of the components that name none; "" if the robot has only one computer."""
        return next(iter(self.machines), "")

    def role_of(self, machine: str) -> Role | None:
        """Return what the users of a machine may do on the others; None: what `cairn ps` needs.

        The first one administers: users on the network connect to it.
        """
        return self.machines[machine].role or (
            "administer" if machine == self.main_machine else None
        )

    def root(self, machine: str = "") -> ChildSpec:
        """Return the root of the tree on a machine: the supervisor of what runs there.

        Without a machine, it is that of all components, as in lockstep. A component whose parent
        runs on another machine is a child of the root here, which starts it when that parent
        requests it.
        """
        if not machine:
            children = self._all_components
        else:
            placed = _placed(self._all_components, self.main_machine)
            children = placed if machine == self.main_machine else {}
            children |= {
                name: spec.model_copy(update={"load": "on_request"})
                for name, spec in _loaded_from_elsewhere(placed, machine, self.main_machine)
            }
        return ChildSpec(
            plugin=_ROOT_PLUGIN,
            placement="in_process",
            supervision=self.supervision,
            children=children,
        )

    def machine_of(self, name: str) -> str:
        """Return the machine of the component of that name; `KeyError` if there is none."""
        machine, member = None, self.member(name)
        while (machine := member.spec.machine) is None and member.parent is not None:
            member = self.member(member.parent)
        return machine or self.main_machine

    def members(self) -> Iterator[Member]:
        """Yield all components in start order, each one followed by its children."""
        yield from _members(self._all_components, None, "components")

    @property
    def _all_components(self) -> dict[str, ChildSpec]:
        """The components, and those that other keys add."""
        found = dict(self.components)
        if self.frames or self.robot_description is not None:
            frames = {name: one.model_dump(mode="json") for name, one in self.frames.items()}
            parameters = {"frames": frames, "robot_description": self.robot_description}
            publisher = ChildSpec(
                plugin=ROBOT_FRAMES, parameters=parameters, placement="in_process"
            )
            found = {ROBOT_FRAMES: publisher, **found}
        if self.ros_names:  # last, so that the services exist before their ROS names
            found[_ROS] = expendable({ROS_NAMES: ChildSpec(plugin=ROS_NAMES)})
        return _with_fallbacks(found, self.main_machine)

    def member(self, name: str) -> Member:
        """Return the component of that name at any depth; `KeyError` if there is none."""
        for member in self.members():
            if member.name == name:
                return member
        raise KeyError(name)


def fallback_name(component: str) -> str:
    """Return the name of a component's fallback."""
    return f"{component}_fallback"


def _with_fallbacks(specs: Mapping[str, ChildSpec], machine: str) -> dict[str, ChildSpec]:
    """Return components, those on other machines than their parent's with their fallbacks.

    `machine` is that of the parent. A fallback is a sibling that is loaded on request.
    """
    found = {}
    for name, spec in specs.items():
        own = spec.machine or machine
        found[name] = spec.model_copy(update={"children": _with_fallbacks(spec.children, own)})
        if spec.fallback is not None and own != machine:
            found[fallback_name(name)] = ChildSpec(
                plugin=spec.fallback.plugin or spec.plugin,
                parameters={**spec.parameters, **spec.fallback.parameters},
                topics=spec.topics,
                max_age_s=spec.max_age_s,
                log_level=spec.log_level,
                load="on_request",
            )
    return found


def _placed(specs: Mapping[str, ChildSpec], machine: str) -> dict[str, ChildSpec]:
    """Return components, each with its machine: by default that of its parent, `machine`."""
    placed = {}
    for name, spec in specs.items():
        own = spec.machine or machine
        update = {"machine": own, "children": _placed(spec.children, own)}
        placed[name] = spec.model_copy(update=update)
    return placed


def _loaded_from_elsewhere(
    placed: Mapping[str, ChildSpec], machine: str, above: str
) -> Iterator[tuple[str, ChildSpec]]:
    """Yield the components on a machine whose parent, on machine `above`, is on another one."""
    for name, spec in placed.items():
        if spec.machine == machine != above:
            yield name, spec
        yield from _loaded_from_elsewhere(spec.children, machine, spec.machine or above)


def root_name(machine: str, main_machine: str) -> str:
    """Return the name of the root of the tree on a machine."""
    return ROOT if machine == main_machine else f"{ROOT}_{machine}"


def view_name(machine: str, main_machine: str) -> str:
    """Return the name of the node with which `cairn up` listens on a machine."""
    return VIEW if machine == main_machine else f"{VIEW}_{machine}"


def expendable(children: dict[str, ChildSpec]) -> ChildSpec:
    """Return a supervisor of components without which the robot continues, however they fail."""
    return ChildSpec(
        plugin="supervisor",
        placement="in_process",
        restart="temporary",
        supervision=Supervision(max_restarts=5, within_s=60.0),
        children=children,
    )


def _records_all_topics(spec: ChildSpec) -> bool:
    """Return whether a component is a recorder of all topics, perhaps with exceptions."""
    return spec.plugin == RECORDER and ALL_TOPICS in spec.parameters.get("topics", (ALL_TOPICS,))


def _members(specs: Mapping[str, ChildSpec], parent: str | None, below: str) -> Iterator[Member]:
    for name, spec in specs.items():
        key = f"{below}.{name}"
        yield Member(name, parent, spec, key)
        yield from _members(spec.children, name, f"{key}.children")
