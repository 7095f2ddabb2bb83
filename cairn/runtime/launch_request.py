"""What is needed to run one component: its part of the deployment, and which start this is."""

from pydantic import BaseModel, ConfigDict, Field

from cairn.bus.credentials import Credentials
from cairn.bus.session import MAX_MESSAGE_SIZE, NO_CREDENTIALS
from cairn.deployment.model import ChildSpec


class RunContext(BaseModel):
    """What all components of one run of a deployment share."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    robot: str = "robot"
    domain: int = 0
    endpoints: tuple[str, ...] = ()
    simulated_time: bool = False
    seed: int = 0
    lockstep: bool = False
    zygote: str = ""  # path of its socket
    socket_folder: str = ""  # for the sockets of the run's processes
    credentials: Credentials = NO_CREDENTIALS
    max_message_size: int = MAX_MESSAGE_SIZE  # bytes
    log_folder: str = ""
    session_secret: str = Field("", repr=False)  # proves which sessions are of this run


class LaunchRequest(BaseModel):
    """One start of one component; sent as JSON to the process that runs it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    spec: ChildSpec
    parent: str = ""
    incarnation: int = 1  # how many times it has been started, this start included
    previous_exit: str = ""  # the reason for which the incarnation before ended
    context: RunContext = RunContext()

    @property
    def restarts(self) -> int:
        """How many times the component has been restarted."""
        return self.incarnation - 1

    @property
    def placement(self) -> str:
        """Where the component runs, as its status reports it."""
        return "lockstep" if self.context.lockstep else self.spec.placement
