"""Ports and handlers: what a component class declares that it reads, publishes and runs."""

import typing
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Generic, Literal, TypeVar, get_args, get_origin

from cairn.bus.message_limits import LONGEST_MAX_BYTES
from cairn.bus.qos import RELIABLE, Qos
from cairn.clock import SECOND
from cairn.errors import CairnError
from cairn.schemas.message import type_name

T = TypeVar("T")
Method = TypeVar("Method", bound=Callable[..., None])


class In(Generic[T]):
    """An input port, declared in the body of a component: `odom: In[Odometry] = In(qos=SENSOR)`.

    A bare annotation `odom: In[Odometry]` means `In()`. With `optional=True` the component works
    without a publisher, and the check of a deployment does not require one. With `exclusive=True`
    the port accepts only the messages of the one component whose output has its topic in the
    deployment; it refuses, counts and reports those of any other publisher. A message longer than
    `max_bytes` is rejected, counted and reported before it is decoded; by default the limit follows
    from the message type: 4 KiB for one of fixed length, 64 KiB with texts, 1 MiB with sequences,
    32 MiB with bytes, such as images and maps.
    """

    def __init__(
        self,
        qos: Qos = RELIABLE,
        *,
        optional: bool = False,
        exclusive: bool = False,
        max_bytes: int | None = None,
    ) -> None:
        if max_bytes is not None and not 1 <= max_bytes <= LONGEST_MAX_BYTES:
            raise CairnError(
                f"In(max_bytes={max_bytes}): a limit is from 1 to {LONGEST_MAX_BYTES:,} bytes"
            )
        self.qos = qos
        self.optional = optional
        self.exclusive = exclusive
        self.max_bytes = max_bytes

    @property
    def topic(self) -> str:
        """The topic that the port reads in this deployment; `CairnError` on a declaration."""
        raise _not_bound("In")

    @property
    def latest(self) -> T | None:
        """The last message handled, None before the first; `CairnError` on a declaration."""
        raise _not_bound("In")


class Out(Generic[T]):
    """An output port, declared in the body of a component: `pose: Out[PoseStamped]`.

    Its quality of service is given as a default: `map: Out[OccupancyGrid] = Out(qos=LATCHED)`. With
    `exclusive=True` the check of a deployment rejects any other component that publishes on its
    topic, also if what reads there is not part of the deployment.
    """

    def __init__(self, qos: Qos = RELIABLE, *, exclusive: bool = False) -> None:
        self.qos = qos
        self.exclusive = exclusive

    @property
    def topic(self) -> str:
        """The topic that the port publishes on in this deployment; `CairnError` if declared."""
        raise _not_bound("Out")

    @property
    def has_subscribers(self) -> bool:
        """Whether a message published now would be received; always True on a latched port.

        For messages that are costly to compute; just publish all others. Raises `CairnError` on a
        declaration.
        """
        raise _not_bound("Out")

    def publish(self, message: T) -> None:  # noqa: ARG002 - the bound port sends it
        """Send a message; an inactive component sends nothing.

        Raises `CairnError` if the message is of another type than the port's, or on a declaration.
        """
        raise _not_bound("Out")


class BoundIn(In[T]):
    """The input of one component instance."""

    def __init__(self, spec: "PortSpec", topic: str) -> None:
        super().__init__(
            spec.qos, optional=spec.optional, exclusive=spec.exclusive, max_bytes=spec.max_bytes
        )
        self._topic = topic
        self._latest: T | None = None

    @property
    def topic(self) -> str:
        """The topic that the port reads in this deployment."""
        return self._topic

    @property
    def latest(self) -> T | None:
        """The last message handled, None before the first."""
        return self._latest

    def set_latest(self, message: T | None) -> None:
        """Set the last message handed to the component's handlers; None clears it."""
        self._latest = message


class BoundOut(Out[T]):
    """The output of one component instance: checks a message's type and hands it to `send`."""

    def __init__(
        self,
        component: str,
        spec: "PortSpec",
        topic: str,
        send: Callable[[T], None],
        has_subscribers: Callable[[], bool],
    ) -> None:
        super().__init__(spec.qos, exclusive=spec.exclusive)
        self._has_subscribers = has_subscribers
        self._component = component
        self._spec = spec
        self._topic = topic
        self._send = send

    @property
    def topic(self) -> str:
        """The topic that the port publishes on in this deployment."""
        return self._topic

    @property
    def has_subscribers(self) -> bool:
        """Whether a message published now would be received; always True on a latched port."""
        return self._has_subscribers()

    def publish(self, message: T) -> None:
        """Send a message; `CairnError` if it is of another type than the port's."""
        if not isinstance(message, self._spec.message):
            raise CairnError(
                f"{self._component}: port {self._spec.name} publishes "
                f"{type_name(self._spec.message)}, not {_type_of(message)}"
            )
        self._send(message)


@dataclass(frozen=True)
class PortSpec:
    """What a component class declares about one port."""

    name: str
    direction: Literal["in", "out"]
    message: type[Any]
    qos: Qos
    optional: bool = False
    exclusive: bool = False
    max_bytes: int | None = None
    """Longest message [bytes] that an input accepts; None: as long as its type has by default."""


def ports_of(cls: type) -> dict[str, PortSpec]:
    """Return the ports that a component class and its bases declare, in order of declaration.

    Raises `CairnError` for a port without a message type, whose message class is not one of
    `cairn.schemas.message`, or whose default is not a port of the annotated direction.
    """
    try:
        hints = typing.get_type_hints(cls, include_extras=True)
    except (NameError, TypeError) as error:
        raise CairnError(
            f"{_qualified_name(cls)}: its annotations cannot be evaluated ({error}); import at "
            "module level, outside `if TYPE_CHECKING`, every name that the class body annotates"
        ) from error
    ports: dict[str, PortSpec] = {}
    for name, hint in hints.items():
        annotation = get_args(hint)[0] if get_origin(hint) is Annotated else hint
        kind = get_origin(annotation) or annotation
        if kind in (In, Out):
            ports[name] = _port(cls, name, kind, get_args(annotation))
    for name, port in _unannotated(cls, ports).items():
        raise _no_message_type(cls, name, type(port))
    return ports


@dataclass(frozen=True)
class PortHandler:
    """A method that handles each message of one input port."""

    port: str


@dataclass(frozen=True)
class TimerHandler:
    """A method that runs periodically, in the component's own time."""

    period_ns: int


_HANDLER_ATTRIBUTE = "_cairn_handler"


def on(port: str) -> Callable[[Method], Method]:
    """Decorate a method to be called with each message of the input `port`, while active.

    Raises `CairnError` for a method that is decorated already.
    """

    def decorate(method: Method) -> Method:
        return _marked(method, PortHandler(port))

    return decorate


def every(*, hz: float) -> Callable[[Method], Method]:
    """Decorate a method to be called `hz` times per second of the component's clock, while active.

    Missed periods are skipped. Raises `CairnError` unless 0 < hz <= 1000, and for a method that
    is decorated already.
    """
    if not 0 < hz <= 1000:
        raise CairnError(f"@every(hz={hz}): a rate must be above 0 and at most 1000 Hz")

    def decorate(method: Method) -> Method:
        return _marked(method, TimerHandler(round(SECOND / hz)))

    return decorate


def handlers_of(cls: type) -> dict[str, PortHandler | TimerHandler]:
    """Return the decorated methods of a component class, in order of declaration, bases first.

    Raises `CairnError` for a handler of a port that is not an input of the class.
    """
    ports = ports_of(cls)
    handlers: dict[str, PortHandler | TimerHandler] = {}
    for base in reversed(cls.__mro__):
        for name, value in vars(base).items():
            handler: Any = getattr(value, _HANDLER_ATTRIBUTE, None)
            if handler is None:
                handlers.pop(name, None)
                continue
            if isinstance(handler, PortHandler):
                spec = ports.get(handler.port)
                if spec is None or spec.direction != "in":
                    inputs = [port.name for port in ports.values() if port.direction == "in"]
                    raise CairnError(
                        f"{_qualified_name(cls)}.{name}: there is no input port {handler.port}; "
                        f"the inputs are {', '.join(inputs) or 'none'}"
                    )
            handlers[name] = handler
    return handlers


def _marked(method: Method, handler: PortHandler | TimerHandler) -> Method:
    if hasattr(method, _HANDLER_ATTRIBUTE):
        raise CairnError(
            f"{method.__qualname__} has two of the decorators @on and @every; "
            "write a method for each"
        )
    setattr(method, _HANDLER_ATTRIBUTE, handler)
    return method


def _port(cls: type, name: str, kind: type, arguments: tuple[Any, ...]) -> PortSpec:
    if not arguments or not isinstance(arguments[0], type):
        raise _no_message_type(cls, name, kind)
    message = arguments[0]
    try:
        type_name(message)
    except TypeError as error:
        raise CairnError(
            f"{_qualified_name(cls)}.{name}: {_qualified_name(message)} is not a message; "
            "use a class decorated with @message of cairn.schemas.message"
        ) from error
    declared = getattr(cls, name, None)
    if declared is None:
        declared = kind()
    if isinstance(declared, In) and kind is In:
        return PortSpec(
            name,
            "in",
            message,
            declared.qos,
            declared.optional,
            declared.exclusive,
            declared.max_bytes,
        )
    if isinstance(declared, Out) and kind is Out:
        return PortSpec(name, "out", message, declared.qos, exclusive=declared.exclusive)
    owner = next(base for base in cls.__mro__ if name in vars(base))
    if name not in vars(owner).get("__annotations__", {}):
        raise CairnError(
            f"{_qualified_name(cls)}.{name}: {owner.__name__} uses the name {name} itself; "
            "give the port another name"
        )
    raise CairnError(
        f"{_qualified_name(cls)}.{name}: annotated {kind.__name__}, but its default is "
        f"{type(declared).__name__}; give {kind.__name__}(...) or no default"
    )


def _unannotated(cls: type, ports: dict[str, PortSpec]) -> dict[str, In[Any] | Out[Any]]:
    return {
        name: value
        for base in cls.__mro__
        for name, value in vars(base).items()
        if isinstance(value, In | Out) and name not in ports
    }


def _no_message_type(cls: type, name: str, kind: type) -> CairnError:
    return CairnError(
        f"{_qualified_name(cls)}.{name}: the port has no message type; "
        f"annotate it, as in `{name}: {kind.__name__}[LaserScan]`"
    )


def _not_bound(kind: str) -> CairnError:
    return CairnError(
        f"this {kind} port is a declaration; only the ports of a component that a deployment, "
        "an executor or a test has started can be used"
    )


def _type_of(message: object) -> str:
    try:
        return type_name(type(message))
    except TypeError:
        return _qualified_name(type(message))


def _qualified_name(cls: type) -> str:
    return f"{cls.__module__}.{cls.__qualname__}"
