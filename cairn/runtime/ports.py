"""Ports and handlers: what a component class declares that it reads, writes and runs."""

import typing
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Generic, Literal, TypeVar, get_args, get_origin

from cairn.bus.qos import RELIABLE, Qos
from cairn.clock import SECOND
from cairn.errors import CairnError
from cairn.schemas.message import type_name

T = TypeVar("T")


class In(Generic[T]):
    """An input, declared in the body of a component: `odom: In[Odometry] = In(qos=SENSOR)`.

    A bare annotation `odom: In[Odometry]` means `In()`. With `optional=True` the component works
    without a writer, and the check of a deployment does not ask for one.
    """

    def __init__(self, qos: Qos = RELIABLE, *, optional: bool = False) -> None:
        self.qos = qos
        self.optional = optional

    @property
    def topic(self) -> str:
        """The topic that the port reads in this deployment; `CairnError` on a declaration."""
        raise _not_bound("In")

    @property
    def latest(self) -> T | None:
        """The last message handled, None before the first; `CairnError` on a declaration."""
        raise _not_bound("In")


class Out(Generic[T]):
    """An output, declared in the body of a component: `pose: Out[Pose]`, or `= Out(qos=...)`."""

    def __init__(self, qos: Qos = RELIABLE) -> None:
        self.qos = qos

    @property
    def topic(self) -> str:
        """The topic that the port writes in this deployment; `CairnError` on a declaration."""
        raise _not_bound("Out")

    @property
    def has_subscribers(self) -> bool:
        """Whether a message published now would come to anybody; `CairnError` on a declaration.

        For messages that are costly to make; all others are just published.
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
        super().__init__(spec.qos, optional=spec.optional)
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

    def handled(self, message: T | None) -> None:
        """Note the message handed to the component's handlers; None forgets it (clean-up)."""
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
        super().__init__(spec.qos)
        self._wanted = has_subscribers
        self._component = component
        self._spec = spec
        self._topic = topic
        self._send = send

    @property
    def topic(self) -> str:
        """The topic that the port writes in this deployment."""
        return self._topic

    @property
    def has_subscribers(self) -> bool:
        """Whether a message published now would come to anybody."""
        return self._wanted()

    def publish(self, message: T) -> None:
        """Send a message; `CairnError` if it is of another type than the port's."""
        if not isinstance(message, self._spec.message):
            raise CairnError(
                f"{self._component}: port {self._spec.name} writes "
                f"{type_name(self._spec.message)}, not {_given(message)}"
            )
        self._send(message)


@dataclass(frozen=True)
class PortSpec:
    """What a component class declares of one port."""

    name: str
    direction: Literal["in", "out"]
    message: type[Any]
    qos: Qos
    optional: bool = False


def ports_of(cls: type) -> dict[str, PortSpec]:
    """The ports that a component class and its bases declare, in order of declaration.

    Raises `CairnError` for a port without a message type, whose message class is not one of
    `cairn.schemas.message`, or whose default is not a port of the annotated direction.
    """
    try:
        hints = typing.get_type_hints(cls, include_extras=True)
    except (NameError, TypeError) as error:
        raise CairnError(
            f"{_name(cls)}: its annotations cannot be evaluated ({error}); import at module level, "
            "outside `if TYPE_CHECKING`, every name that the class body annotates"
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


def _port(cls: type, name: str, kind: type, arguments: tuple[Any, ...]) -> PortSpec:
    if not arguments or not isinstance(arguments[0], type):
        raise _no_message_type(cls, name, kind)
    message = arguments[0]
    try:
        type_name(message)
    except TypeError as error:
        raise CairnError(
            f"{_name(cls)}.{name}: {_name(message)} is not a message; "
            "a port carries a class decorated with @message of cairn.schemas.message"
        ) from error
    declared = getattr(cls, name, None)
    if declared is None:
        declared = kind()
    if isinstance(declared, In) and kind is In:
        return PortSpec(name, "in", message, declared.qos, declared.optional)
    if isinstance(declared, Out) and kind is Out:
        return PortSpec(name, "out", message, declared.qos)
    owner = next(base for base in cls.__mro__ if name in vars(base))
    if name not in vars(owner).get("__annotations__", {}):
        raise CairnError(
            f"{_name(cls)}.{name}: {owner.__name__} uses the name {name} itself; "
            "give the port another name"
        )
    raise CairnError(
        f"{_name(cls)}.{name}: annotated {kind.__name__}, but its default is "
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
        f"{_name(cls)}.{name}: the port has no message type; "
        f"annotate it, as in `{name}: {kind.__name__}[LaserScan]`"
    )


def _not_bound(kind: str) -> CairnError:
    return CairnError(
        f"this {kind} port is a declaration; only the ports of a component that a deployment, "
        "an executor or a test has started can be used"
    )


def _given(message: object) -> str:
    try:
        return type_name(type(message))
    except TypeError:
        return _name(type(message))


def _name(cls: type) -> str:
    return f"{cls.__module__}.{cls.__qualname__}"


Method = TypeVar("Method", bound=Callable[..., None])
_MARK = "_cairn_handler"


@dataclass(frozen=True)
class PortHandler:
    """A method that handles each message of one input port."""

    port: str


@dataclass(frozen=True)
class TimerHandler:
    """A method that runs periodically, in the component's own time."""

    period_ns: int


def on(port: str) -> Callable[[Method], Method]:
    """Call the method with each message of the input `port`, one at a time, while active.

    Raises `CairnError` for a method that is marked already.
    """

    def mark(method: Method) -> Method:
        return _marked(method, PortHandler(port))

    return mark


def every(*, hz: float) -> Callable[[Method], Method]:
    """Call the method `hz` times per second of the component's clock while active.

    Periods that were missed are not made up for. Raises `CairnError` unless 0 < hz <= 1000, and
    for a method that is marked already.
    """
    if not 0 < hz <= 1000:
        raise CairnError(f"@every(hz={hz}): a rate must be above 0 and at most 1000 Hz")

    def mark(method: Method) -> Method:
        return _marked(method, TimerHandler(round(SECOND / hz)))

    return mark


def _marked(method: Method, handler: PortHandler | TimerHandler) -> Method:
    if hasattr(method, _MARK):
        raise CairnError(
            f"{method.__qualname__} has two of the decorators @on and @every; "
            "write a method for each"
        )
    setattr(method, _MARK, handler)
    return method


def handlers_of(cls: type) -> dict[str, PortHandler | TimerHandler]:
    """The marked methods of a component class by name, in order of declaration, bases first.

    Raises `CairnError` for a handler of a port that is not an input of the class.
    """
    ports = ports_of(cls)
    found: dict[str, PortHandler | TimerHandler] = {}
    for base in reversed(cls.__mro__):
        for name, value in vars(base).items():
            handler: Any = getattr(value, _MARK, None)
            if handler is None:
                found.pop(name, None)
                continue
            if isinstance(handler, PortHandler):
                spec = ports.get(handler.port)
                if spec is None or spec.direction != "in":
                    inputs = [port.name for port in ports.values() if port.direction == "in"]
                    raise CairnError(
                        f"{cls.__module__}.{cls.__qualname__}.{name}: there is no input port "
                        f"{handler.port}; the inputs are {', '.join(inputs) or 'none'}"
                    )
            found[name] = handler
    return found
