"""The base class of every component: what its author overrides, and what it is given."""

import logging
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Literal, Protocol, get_type_hints

import numpy as np

from cairn.clock import Clock
from cairn.errors import CairnError
from cairn.runtime.parameters import Config


class ComponentContext(Protocol):
    """What the runtime gives a component; not for use by component authors."""

    name: str
    config: Config
    clock: Clock
    log: logging.Logger
    random: np.random.Generator
    restarts: int

    def schedule(self, at: int, call: Callable[[], None]) -> None:
        """Run `call` once at that time of the component's clock, while active."""
        ...

    def post(self, call: Callable[[], None]) -> None:
        """Run `call` among the handlers, while active; from any thread."""
        ...

    def finish(self, reason: str, *, success: bool = True) -> None:
        """End the component normally once the current handler returns."""
        ...


class Component:
    """A task component or a driver: reads ports, writes ports, has parameters and a life cycle.

    Subclasses annotate ports (`odom: In[Odometry]`, `pose: Out[PoseStamped]`) and, if they have
    parameters, `config: TheirConfig`. Handlers (`@on`, `@every`) and life-cycle methods are
    called one at a time, in order of arrival, so that no locks are needed; not always on the same
    thread, so that `sqlite3` wants `check_same_thread=False`. An exception fails the component: see
    `on_error`. Time comes from `self.clock` alone, randomness from `self.random` alone.
    """

    is_supervisor: ClassVar[bool] = False
    clock_source: ClassVar[Literal["deployment", "system", "device"]] = "deployment"
    """`system`: this component keeps system time even where the deployment's time is simulated.

    `device`: it drives a device, which lives in the system's time alone: it is refused in lockstep,
    and where the deployment's time is simulated.
    """

    config: Config

    def __init__(self, context: ComponentContext) -> None:
        """Called by the runtime; take memory and open devices in `on_configure`, not here."""
        self._context = context

    @classmethod
    def config_class(cls) -> type[Config]:
        """The class that `config` is annotated with."""
        annotation = get_type_hints(cls).get("config", Config)
        if not (isinstance(annotation, type) and issubclass(annotation, Config)):
            raise CairnError(
                f"{cls.__module__}.{cls.__qualname__}: config is annotated {annotation!r}; "
                "derive its class from cairn.runtime.parameters.Config"
            )
        return annotation

    @property
    def name(self) -> str:
        """The component's name in its deployment."""
        return self._context.name

    @property
    def clock(self) -> Clock:
        """The component's time: the system's, simulated, or lockstep."""
        return self._context.clock

    @property
    def log(self) -> logging.Logger:
        """Writes to the component's log, and to the topic /rosout."""
        return self._context.log

    @property
    def random(self) -> np.random.Generator:
        """The component's only source of randomness, seeded by the run's seed and its name."""
        return self._context.random

    @property
    def restarts(self) -> int:
        """How often the component was started before in this run: above 0 it may resume work."""
        return self._context.restarts

    def schedule(self, at: int, call: Callable[[], None]) -> None:
        """Run `call` once when `self.clock` reaches `at` [ns]; forgotten on deactivation."""
        self._context.schedule(at, call)

    def post(self, call: Callable[[], None]) -> None:
        """Run `call` as one of the handlers, soon; forgotten if the component is not active then.

        This, and the log, are all that a thread of a driver's own may use of its component. It
        returns at once; another thread makes the call.
        """
        self._context.post(call)

    def finish(self, reason: str, *, success: bool = True) -> None:
        """End normally, not to be restarted, once the current handler returns.

        Without `success` its work is over, but what it was to do was not done: if that ends the
        deployment, `cairn up` ends with exit status 1.
        """
        self._context.finish(reason, success=success)

    def on_configure(self) -> None:
        """Take memory, open devices and files; raise to say why it cannot be done."""

    def on_activate(self) -> None:
        """Begin to work; from now on handlers are called and messages are sent."""

    def on_deactivate(self) -> None:
        """Stop working, stay configured; the last messages may be sent here."""

    def on_cleanup(self) -> None:
        """Give back what `on_configure` took."""

    def on_shutdown(self) -> None:
        """Give back everything; the component is not used again."""

    def on_error(self, error: Exception) -> bool:  # noqa: ARG002 - for those who override it
        """Tidy up after an exception in a handler or a transition.

        Return True if the component can be configured anew in the same process; by default
        it ends, and its supervisor decides.
        """
        return False

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:  # noqa: ARG002
        """Answer a control request of the component's own, with a value that JSON can carry.

        Raises `CairnError` for one that it does not know, which is every one by default.
        """
        raise CairnError(f"{self.name} does not know the request {verb}")

    def on_parameters(self, new: Config) -> None:
        """Judge a valid change of parameters before it is made.

        Raise `ParameterRejected` to keep all parameters as they are. `self.config` is still the
        old one here and becomes `new` when this returns.
        """
