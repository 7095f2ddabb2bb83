"""The deployment format: a tree of components, each with where and how it runs."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field

from cairn.bus.endpoints import MAX_DOMAIN, default_domain
from cairn.bus.keys import ROS_NAMES
from cairn.bus.roles import Role
from cairn.deployment.bus_settings import BusSettings
from cairn.runtime.child_spec import (
    ChildSpec,
    LogLevel,
    Name,
    Section,
    Storage,
    Supervision,
    Topic,
)
from cairn.runtime.robot import FrameName, Robot, RobotOrName
from cairn.tf.robot_frames import BASE_FRAME
from cairn.tf.transform import Transform
from cairn.tf.urdf import Joint

Meters = Annotated[float, Field(ge=-5, le=5, allow_inf_nan=False)]

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


class Frame(Section):
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


@dataclass(frozen=True)
class Member:
    """A component with its position in the tree; `parent` is None directly below the root.

    `key` is its path in the deployment, as `--set` takes it: `components.mobile.children.base`.
    """

    name: str
    parent: str | None
    spec: ChildSpec
    key: str


class Machine(Section):
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


class Deployment(Section):
    """A whole deployment of a robot: the tree of components, their bus and their clock."""

    cairn: Literal[1] = Field(description="Version of this format.")
    robot: RobotOrName = Field(
        default_factory=Robot,
        description="The robot: its name, or what its components have in common.",
    )
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
            inherited = spec.parameters if spec.fallback.plugin is None else {}
            found[fallback_name(name)] = ChildSpec(
                plugin=spec.fallback.plugin or spec.plugin,
                parameters={**inherited, **spec.fallback.parameters},
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
