"""What is needed to run one component: its part of the deployment, and which start this is."""

from collections.abc import Iterator, Mapping

from pydantic import BaseModel, ConfigDict, Field

from cairn.bus.bus import full_name
from cairn.bus.credentials import NO_CREDENTIALS, Credentials
from cairn.bus.exclusive import Exclusive, ExclusiveTopic
from cairn.bus.message_limits import MessageLimits
from cairn.runtime.child_spec import ChildSpec, LogLevel, Storage


class RunContext(BaseModel):
    """What all components of one run of a deployment share."""

    model_config = ConfigDict(extra="forbid", frozen=True, hide_input_in_errors=True)  # secrets

    robot: str = "robot"
    domain: int = 0
    endpoints: tuple[str, ...] = ()
    simulated_time: bool = False
    seed: int = 0
    stop_limit_s: float = 10.0
    lockstep: bool = False
    call_log: bool = False
    zygote: str = ""  # path of its socket
    socket_folder: str = ""  # for the sockets of the run's processes
    credentials: Credentials = NO_CREDENTIALS
    message_limits: MessageLimits = MessageLimits()
    log_folder: str = ""
    log_level: LogLevel = "info"
    storage: Storage = Storage()
    session_secret: str = Field("", repr=False)  # proves which sessions are of this run
    deployment: str = Field("", repr=False)
    """The deployment as it runs, with all overlays and settings, as JSON."""
    machine: str = ""
    """The machine of the robot on which the component runs; "" if it has only one."""
    machines: tuple[str, ...] = ()
    """All machines of the robot, the main one first."""
    parents: Mapping[str, str] = {}
    """The parent of each component that the root starts here for a parent on another machine."""
    clock_tolerance_s: float = 0.1
    remote_topics: Mapping[str, str] = {}
    """The machine of the publishers of each topic (full name) that is published elsewhere only."""
    exclusive_topics: tuple[ExclusiveTopic, ...] | None = None
    """None for a component that runs without a deployment, in a test: it accepts every writer."""


class LaunchRequest(BaseModel):
    """One start of one component; sent as JSON to the process that runs it."""

    model_config = ConfigDict(extra="forbid", frozen=True, hide_input_in_errors=True)  # secrets

    name: str
    spec: ChildSpec
    parent: str = ""
    # How many times it has been started, this start included; the restarts of the supervisors above
    # it count, too.
    incarnation: int = 1
    previous_exit: str = ""  # the reason for which the incarnation before ended
    context: RunContext = RunContext()
    topic_keys: Mapping[str, str] = Field({}, repr=False)
    """Secrets [hexadecimal] of the exclusive topics that the component, or one below it, uses.

    By the topic's full name. They must not appear in a log, on a command line or in an environment.
    """

    @property
    def restarts(self) -> int:
        """How many times the component has been restarted."""
        return self.incarnation - 1

    @property
    def placement(self) -> str:
        """Where the component runs, as its status reports it."""
        return "lockstep" if self.context.lockstep else self.spec.placement

    def exclusive(self, topic: str) -> Exclusive | None:
        """Return who may publish on an exclusive topic (full name); None if everyone may.

        A topic that is not among the exclusive ones of the deployment has no entitled writer.
        """
        topics = self.context.exclusive_topics
        if topics is None:
            return None
        found = next((one for one in topics if one.topic == topic), None)
        if found is not None and found.external:
            return None
        writer = full_name(self.context.robot, found.writer) if found and found.writer else ""
        key = bytes.fromhex(self.topic_keys.get(topic, ""))
        return Exclusive(writer, key, several_machines=bool(found and found.several_machines))

    def is_elsewhere(self, child: ChildSpec) -> bool:
        """Return whether a child of this component runs on another machine."""
        own = self.context.machine
        return bool(own) and child.machine is not None and child.machine != own

    def keys_for(self, name: str) -> dict[str, str]:
        """Return those of the secrets that the child of that name, or one below it, needs."""
        names = {name, *_names_below(self.spec.children[name])}
        return {
            one.topic: self.topic_keys[one.topic]
            for one in self.context.exclusive_topics or ()
            if one.topic in self.topic_keys and names & {one.writer, *one.readers}
        }


def _names_below(spec: ChildSpec) -> Iterator[str]:
    for name, child in spec.children.items():
        yield name
        yield from _names_below(child)
