"""The base class of every component: what its author overrides, and what it may use."""

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol, get_type_hints

import numpy as np

from cairn.bus.bus import Bus, Node
from cairn.bus.roles import Role
from cairn.errors import CairnError
from cairn.runtime.call_log import CallLog
from cairn.runtime.loop import Scheduler
from cairn.runtime.parameters import COMMON_PARAMETERS, Config
from cairn.system.clock import Clock

if TYPE_CHECKING:
    from cairn.runtime.launch_request import LaunchRequest
    from cairn.runtime.node_services import NodeService


class ComponentContext(Protocol):
    """What the runtime provides to a component and its ports; for no direct use by authors."""

    name: str
    config: Config
    clock: Clock
    unlogged_clock: Clock
    """The component's time, read without a record in the call log."""
    log: logging.Logger
    random: np.random.Generator
    restarts: int
    bus: Bus
    node: Node
    scheduler: Scheduler
    launch: "LaunchRequest"
    call_log: CallLog | None

    @property
    def may_publish(self) -> bool:
        """Whether messages may be sent now."""

    def run(self, where: str, call: Callable[..., None], *arguments: Any) -> None:
        """Make one call into the component, while active."""

    def schedule(self, at: int, call: Callable[[], None]) -> None:
        """Make `call` once at time `at` [ns] of the component's clock, while active."""

    def post(self, call: Callable[[], None]) -> None:
        """Make `call` among the handlers, while active; from any thread."""

    def finish(self, reason: str, *, success: bool = True) -> None:
        """End the component normally once the current handler returns."""

    def report_problem(self, subject: str, problem: str | None) -> None:
        """Add a problem to the component's status; None: it is solved."""

    def request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Make a control request of the component itself, as a client does."""

    def serve_node(self, name: str, services: "Sequence[NodeService]") -> None:
        """Serve services below the node of that full name, in every state, until the end."""


class Component:
    """A task component or a driver, with ports, parameters and a life cycle.

    A subclass annotates its ports (`odom: In[Odometry]`, `pose: Out[PoseStamped]`) and, if it has
    parameters, `config: TheirConfig`. Handlers (`@on`, `@every`) and life-cycle methods are called
    one at a time, in order of arrival, so they need no locks. They are not always called on the
    same thread: `sqlite3`, for example, needs `check_same_thread=False`. An exception fails the
    component: see `on_error`. Take time only from `self.clock` and randomness only from
    `self.random`, so that simulation and replay work.
    """

    is_supervisor: ClassVar[bool] = False
    clock_source: ClassVar[Literal["deployment", "system", "device"]] = "deployment"
    """Where the component's time comes from.

    `deployment`: the deployment's clock, which may be simulated. `system`: the system's time, also
    where the deployment's time is simulated. `device`: the component drives a device, which exists
    only in the system's time: it is rejected in lockstep and where time is simulated.
    """

    request_roles: ClassVar[Mapping[str, Role]] = MappingProxyType({})
    """Which of its own requests users on the network with less than `administer` may make."""
    service_roles: ClassVar[Mapping[str, Role]] = MappingProxyType({})
    """Server and action server ports that users on the network with less than `administer` may use.
    """
    request_max_bytes: ClassVar[Mapping[str, int]] = MappingProxyType({})
    """Longest requests [bytes of JSON] of its own verbs, where not 64 KiB; at most 256 KiB."""
    urgent_requests: ClassVar[frozenset[str]] = frozenset()
    """Requests that are accepted also while too many others wait: to stop something."""
    operator_inputs: ClassVar[frozenset[str]] = frozenset()
    """Input ports on whose topics users on the network with the role `operate` may publish."""
    confidential_inputs: ClassVar[frozenset[str]] = frozenset()
    """Input ports whose topics users on the network with less than `administer` may not read."""

    live_parameters: ClassVar[frozenset[str] | None] = None
    """Parameters, or groups of them, that can be changed while it runs; None: all."""

    published_frames: ClassVar[frozenset[str]] = frozenset()
    """Frames whose transforms to their parents it publishes, so that nothing else may."""

    config: Config

    def __init__(self, context: ComponentContext) -> None:
        """Called by the runtime; allocate memory and open devices in `on_configure`, not here."""
        self._context = context

    @classmethod
    def config_class(cls) -> type[Config]:
        """Return the class that `config` is annotated with.

        Raises `CairnError` if it is not a subclass of `Config`.
        """
        annotation = get_type_hints(cls).get("config", Config)
        if not (isinstance(annotation, type) and issubclass(annotation, Config)):
            raise CairnError(
                f"{cls.__module__}.{cls.__qualname__}: config is annotated {annotation!r}; "
                "derive its class from cairn.Config"
            )
        for name in COMMON_PARAMETERS:
            if name in annotation.model_fields:
                raise CairnError(
                    f"{cls.__module__}.{cls.__qualname__}: every component has a parameter {name} "
                    "already; rename that of its config"
                )
        return annotation

    @classmethod
    def check_neighbors(
        cls,
        config: Config,
        neighbors: Mapping[str, Mapping[str, Config]],
    ) -> Iterable[tuple[str, str, str]]:
        """Return which parameters do not fit those of the components on the same topics.

        `cairn check` and `cairn up` report them as errors. `neighbors` has, for each port, the
        components at its other end with their parameters; a topic under `external_topics` has one
        without parameters, `external_topics`. An error is a parameter of this component (dotted),
        what is wrong, and the remedy. By default there is none.
        """
        return ()

    @property
    def name(self) -> str:
        """The component's name in its deployment."""
        return self._context.name

    @property
    def robot(self) -> str:
        """The robot's name: the namespace of the deployment's topics and components."""
        return self._context.launch.context.robot

    @property
    def clock(self) -> Clock:
        """The component's time: the system's, simulated, or lockstep.

        A driver may call `self.clock.now()` on its device thread, too. With
        `clock_source = "device"` it is the system's time.
        """
        return self._context.clock

    @property
    def time_may_repeat(self) -> bool:
        """Whether another run may begin at an earlier time: with simulated time, and in lockstep.

        Only then data of a later time are of another run, such as a replay of the same recording.
        The system's time goes back when a wrong clock is corrected.
        """
        context = self._context.launch.context
        return context.simulated_time or context.lockstep

    @property
    def log(self) -> logging.Logger:
        """Writes to the component's log file and to the topic /rosout, from its log level on."""
        return self._context.log

    @property
    def random(self) -> np.random.Generator:
        """The component's only source of randomness, seeded by the run's seed and its name."""
        return self._context.random

    @property
    def restarts(self) -> int:
        """How often the component was restarted in this run; above 0 it may resume its work."""
        return self._context.restarts

    def schedule(self, at: int, call: Callable[[], None]) -> None:
        """Make `call` once when `self.clock` reaches `at` [ns]; discarded on deactivation.

        If the clock is set back meanwhile, `at` is, too, by as much: a call that is to come in a
        second does not come in an hour.
        """
        self._context.schedule(at, call)

    def post(self, call: Callable[[], None]) -> None:
        """Make `call` soon, as one of the handlers; discarded if the component is not active then.

        A driver's own thread may use only this, `clock` and `log` of its component. It returns at
        once; another thread makes the call.
        """
        self._context.post(call)

    def finish(self, reason: str, *, success: bool = True) -> None:
        """End normally, without a restart, once the current handler returns.

        With `success=False` the component ends normally, but it did not achieve its purpose: if
        its end ends the deployment, `cairn up` exits with status 1.
        """
        self._context.finish(reason, success=success)

    def report_problem(self, subject: str, problem: str | None) -> None:
        """Show in the status (`cairn ps`) what does not work at present; None: it is solved.

        There is one problem for each `subject`, the last one reported.
        """
        self._context.report_problem(subject, problem)

    def report_state(self, state: str) -> None:
        """Show in the status (`cairn ps`) what the component is doing; "": nothing to report."""
        self._context.report_problem("", state or None)

    def on_configure(self) -> None:
        """Allocate memory, open devices and files; raise an error that says why that fails."""

    def on_activate(self) -> None:
        """Start working; from now on handlers are called and messages are sent."""

    def on_deactivate(self) -> None:
        """Stop working and stay configured; the last messages may be sent here."""

    def on_cleanup(self) -> None:
        """Release what `on_configure` allocated and opened."""

    def on_shutdown(self) -> None:
        """Release everything; the component is not used again."""

    def on_error(self, error: Exception) -> bool:
        """Clean up after an exception in a handler or a transition.

        Return True if the component can be configured again in the same process; by default it
        ends, and its supervisor decides.
        """
        return False

    def on_stale(self, port: str, age_s: float) -> None:
        """React to an input whose newest message is older than its `max_age_s`, or missing.

        It is called once, when the input becomes stale; `age_s` is its age then [s].
        """

    def on_fresh(self, port: str) -> None:
        """React to an input that was stale and has a current message again."""

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Return the reply to a control request of the component's own, a value that is JSON.

        Raises `CairnError` for an unknown request, which is every one by default.
        """
        raise CairnError(f"{self.name}: unknown request {verb}")

    def on_parameters(self, new: Config) -> None:
        """Check a valid change of `live_parameters` before it takes effect.

        Raise `ParameterRejected` to keep all parameters as they are. `self.config` is still the old
        configuration here and becomes `new` when this returns.
        """
