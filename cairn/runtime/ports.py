"""Ports and handlers: what a component class declares that it reads, publishes and runs."""

import typing
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Generic, Literal, TypeVar, get_args, get_origin

from cairn.bus.actions import (
    CANCEL_GOAL,
    FEEDBACK,
    GET_RESULT,
    SEND_GOAL,
    STATUS,
    ClientGoal,
    ServerGoal,
)
from cairn.bus.bus import ServiceError
from cairn.bus.message_limits import LONGEST_MAX_BYTES
from cairn.bus.qos import LATCHED, RELIABLE, Qos
from cairn.errors import CairnError
from cairn.schemas.action_msgs.msg import GoalStatusArray
from cairn.schemas.action_msgs.srv import CancelGoal
from cairn.schemas.definitions import DefinitionError
from cairn.schemas.interfaces import interface
from cairn.schemas.message import Action, Service, type_name
from cairn.system.clock import SECOND

T = TypeVar("T")
Goal = TypeVar("Goal")
Result = TypeVar("Result")
Feedback = TypeVar("Feedback")
Request = TypeVar("Request")
Response = TypeVar("Response")
Method = TypeVar("Method", bound=Callable[..., None])
ServiceMethod = TypeVar("ServiceMethod", bound=Callable[..., Any])
Marked = TypeVar("Marked", bound=Callable[..., Any])


_LONGEST_AGE_S = 3600.0


class In(Generic[T]):
    """An input port, declared in the body of a component: `odom: In[Odometry] = In(qos=SENSOR)`.

    A bare annotation `odom: In[Odometry]` means `In()`. With `optional=True` the component works
    without a publisher, and the check of a deployment does not require one. With `exclusive=True`
    the port accepts only the messages of the one component whose output has its topic in the
    deployment; it refuses, counts and reports those of any other publisher. A message longer than
    `max_bytes` is rejected, counted and reported before it is decoded; by default the limit follows
    from the message type: 4 KiB for one of fixed length, 64 KiB with texts, 1 MiB with sequences,
    32 MiB with bytes, such as images and maps. An input without a message younger than `max_age_s`
    [s] is stale: the component logs and shows it, and `Component.on_stale` is called.
    """

    def __init__(
        self,
        qos: Qos = RELIABLE,
        *,
        optional: bool = False,
        exclusive: bool = False,
        max_bytes: int | None = None,
        max_age_s: float | None = None,
    ) -> None:
        _check_max_bytes("In", max_bytes)
        if max_age_s is not None and (qos.latched or not 0 < max_age_s <= _LONGEST_AGE_S):
            raise CairnError(
                f"In(max_age_s={max_age_s}): an age is above 0 and at most {_LONGEST_AGE_S:g} s, "
                "and not for a latched input, whose last message stays valid"
            )
        self.max_age_s = max_age_s
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


class Server(Generic[Request, Response]):
    """A service that the component provides, while it is active.

    `save_map: Server[SaveMap.Request, SaveMap.Response]`; a method decorated `@serve("save_map")`
    answers its calls. A request longer than `max_bytes` is refused before it is decoded; the
    default limit follows from the type, as for `In`.
    """

    def __init__(self, *, max_bytes: int | None = None) -> None:
        _check_max_bytes("Server", max_bytes)
        self.max_bytes = max_bytes

    @property
    def service(self) -> str:
        """The full name of the service in this deployment; `CairnError` on a declaration."""
        raise _not_bound("Server")


class Client(Generic[Request, Response]):
    """A service that the component calls, while it is active.

    `plan: Client[GetPlan.Request, GetPlan.Response]`. With `optional=True` the component works
    without a server, and the check of a deployment does not require one.
    """

    def __init__(self, *, optional: bool = False) -> None:
        self.optional = optional

    @property
    def service(self) -> str:
        """The full name of the service in this deployment; `CairnError` on a declaration."""
        raise _not_bound("Client")

    @property
    def is_available(self) -> bool:
        """Whether there is a server; `CairnError` on a declaration."""
        raise _not_bound("Client")

    def call(
        self,
        request: Request,  # noqa: ARG002 - the bound port sends it
        on_response: Callable[[Response], None],  # noqa: ARG002
        on_failure: Callable[[ServiceError], None] | None = None,  # noqa: ARG002
        *,
        timeout_s: float = 5.0,  # noqa: ARG002
    ) -> None:
        """Call the service, without waiting: one of the functions is called later as a handler.

        `on_failure` gets the reason if there is no server, it ends, refuses the call, or does not
        answer within the time limit; without it, the reason is logged as a warning. A component
        that becomes inactive gets no answer any more. Raises `CairnError` if the request is of
        another type than the port's, or on a declaration.
        """
        raise _not_bound("Client")


class ActionServer(Generic[Goal, Result, Feedback]):
    """An action that the component provides, while it is active.

    `spin: ActionServer[Spin.Goal, Spin.Result, Spin.Feedback]`; a method decorated
    `@goal("spin")` begins to pursue each goal, one decorated `@cancel("spin")` to end it early.
    Without the latter, goals cannot be canceled. When the component becomes inactive, its goals are
    aborted.
    """

    @property
    def action(self) -> str:
        """The full name of the action in this deployment; `CairnError` on a declaration."""
        raise _not_bound("ActionServer")

    @property
    def goals(self) -> Sequence[ServerGoal[Goal, Result, Feedback]]:
        """The goals that have not ended, the oldest first; `CairnError` on a declaration."""
        raise _not_bound("ActionServer")

    def restore(self, identity: bytes, goal: Goal) -> ServerGoal[Goal, Result, Feedback]:  # noqa: ARG002
        """Return a goal that was accepted before a restart of the component, executing again.

        Its client can get the result as if nothing had happened. Raises `CairnError` on a
        declaration.
        """
        raise _not_bound("ActionServer")


class ActionClient(Generic[Goal, Result, Feedback]):
    """An action that the component uses, while it is active.

    `spin: ActionClient[Spin.Goal, Spin.Result, Spin.Feedback]`. With `optional=True` the component
    works without a server, and the check of a deployment does not require one.
    """

    def __init__(self, *, optional: bool = False) -> None:
        self.optional = optional

    @property
    def action(self) -> str:
        """The full name of the action in this deployment; `CairnError` on a declaration."""
        raise _not_bound("ActionClient")

    @property
    def is_available(self) -> bool:
        """Whether there is a server; `CairnError` on a declaration."""
        raise _not_bound("ActionClient")

    def send(
        self,
        goal: Goal,  # noqa: ARG002 - the bound port sends it
        on_result: Callable[[int, Result], None],  # noqa: ARG002
        on_failure: Callable[[ServiceError], None] | None = None,  # noqa: ARG002
        *,
        on_accepted: Callable[[], None] | None = None,  # noqa: ARG002
        on_feedback: Callable[[Feedback], None] | None = None,  # noqa: ARG002
        timeout_s: float = 5.0,  # noqa: ARG002
    ) -> ClientGoal[Goal, Result, Feedback]:
        """Send a goal, without waiting: the functions are called later as handlers.

        `on_result` gets the final status, one of the constants of `action_msgs/msg/GoalStatus`, and
        the result. `on_failure` is called in its place, with the reason, if the server rejects the
        goal, does not answer within the time limit, or ends; without it, the reason is logged as a
        warning. Raises `CairnError` if the goal is of another type than the port's, or on a
        declaration.
        """
        raise _not_bound("ActionClient")


class BoundIn(In[T]):
    """The input of one component instance."""

    def __init__(self, spec: "PortSpec", topic: str) -> None:
        super().__init__(
            spec.qos,
            optional=spec.optional,
            exclusive=spec.exclusive,
            max_bytes=spec.max_bytes,
            max_age_s=spec.max_age_s,
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


class BoundServer(Server[Request, Response]):
    """The server of one component instance."""

    def __init__(self, spec: "ServiceSpec", service: str) -> None:
        super().__init__(max_bytes=spec.max_bytes)
        self._service = service

    @property
    def service(self) -> str:
        """The full name of the service in this deployment."""
        return self._service


class BoundClient(Client[Request, Response]):
    """The client of one component instance: checks a request's type and hands it to `send`."""

    def __init__(
        self,
        component: str,
        spec: "ServiceSpec",
        service: str,
        send: Callable[..., None],
        is_available: Callable[[], bool],
    ) -> None:
        super().__init__(optional=spec.optional)
        self._component = component
        self._spec = spec
        self._service = service
        self._send = send
        self._is_available = is_available

    @property
    def service(self) -> str:
        """The full name of the service in this deployment."""
        return self._service

    @property
    def is_available(self) -> bool:
        """Whether there is a server."""
        return self._is_available()

    def call(
        self,
        request: Request,
        on_response: Callable[[Response], None],
        on_failure: Callable[[ServiceError], None] | None = None,
        *,
        timeout_s: float = 5.0,
    ) -> None:
        """Call the service; `CairnError` if the request is of another type than the port's."""
        if not isinstance(request, self._spec.service.Request):
            raise CairnError(
                f"{self._component}: port {self._spec.name} calls "
                f"{type_name(self._spec.service)}, whose request is not {_type_of(request)}"
            )
        self._send(request, on_response, on_failure, timeout_s)


@dataclass(frozen=True)
class ServiceSpec:
    """What a component class declares about one server or client port."""

    name: str
    role: Literal["server", "client"]
    service: type[Service[Any, Any]]
    optional: bool = False
    max_bytes: int | None = None


@dataclass(frozen=True)
class ActionSpec:
    """What a component class declares about one action server or client port."""

    name: str
    role: Literal["server", "client"]
    action: type[Action[Any, Any, Any]]
    optional: bool = False

    def services(self) -> dict[str, ServiceSpec]:
        """Return its three services, by their names below that of the action."""
        services = {
            SEND_GOAL: self.action.SendGoal,
            CANCEL_GOAL: CancelGoal,
            GET_RESULT: self.action.GetResult,
        }
        return {
            part: ServiceSpec(f"{self.name}/{part}", self.role, service, self.optional)
            for part, service in services.items()
        }

    def topics(self) -> dict[str, "PortSpec"]:
        """Return its topics, by their names below that of the action; a client reads feedback."""
        direction: Literal["in", "out"] = "out" if self.role == "server" else "in"
        feedback = PortSpec(
            f"{self.name}/{FEEDBACK}",
            direction,
            self.action.FeedbackMessage,
            RELIABLE,
            optional=True,
        )
        if self.role == "client":
            return {FEEDBACK: feedback}
        status = PortSpec(f"{self.name}/{STATUS}", "out", GoalStatusArray, LATCHED)
        return {FEEDBACK: feedback, STATUS: status}


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
    max_age_s: float | None = None
    """Age [s] from which an input is stale; None: its age is not watched."""


def ports_of(cls: type) -> dict[str, PortSpec]:
    """Return the ports that a component class and its bases declare, in order of declaration.

    Raises `CairnError` for a port without a message type, whose message class is not one of
    `cairn.schemas.message`, or whose default is not a port of the annotated direction.
    """
    ports = {
        name: _port(cls, name, kind, arguments)
        for name, kind, arguments in _annotated(cls)
        if kind in (In, Out)
    }
    for name, port in _unannotated(cls, ports, In | Out).items():
        raise _no_message_type(cls, name, type(port))
    return ports


def services_of(cls: type) -> dict[str, ServiceSpec]:
    """Return the servers and clients that a component class and its bases declare, in order.

    Raises `CairnError` for one whose classes are not the request and response of one service, or
    whose default is not a port of the annotated kind.
    """
    services = {
        name: _service(cls, name, kind, arguments)
        for name, kind, arguments in _annotated(cls)
        if kind in (Server, Client)
    }
    for name, port in _unannotated(cls, services, Server | Client).items():
        raise _no_service_type(cls, name, type(port))
    return services


def actions_of(cls: type) -> dict[str, ActionSpec]:
    """Return the action servers and clients that a component class and its bases declare.

    Raises `CairnError` for one whose classes are not goal, result and feedback of one action, or
    whose default is not a port of the annotated kind.
    """
    actions = {
        name: _action(cls, name, kind, arguments)
        for name, kind, arguments in _annotated(cls)
        if kind in (ActionServer, ActionClient)
    }
    for name, port in _unannotated(cls, actions, ActionServer | ActionClient).items():
        raise _no_action_type(cls, name, type(port))
    return actions


@cache
def _annotated(cls: type) -> tuple[tuple[str, Any, tuple[Any, ...]], ...]:
    """Return the annotations of a class and its bases: name, generic class, type arguments."""
    try:
        hints = typing.get_type_hints(cls, include_extras=True)
    except (NameError, TypeError) as error:
        raise CairnError(
            f"{_qualified_name(cls)}: its annotations cannot be evaluated ({error}); import at "
            "module level, outside `if TYPE_CHECKING`, every name that the class body annotates"
        ) from error
    found = []
    for name, hint in hints.items():
        annotation = get_args(hint)[0] if get_origin(hint) is Annotated else hint
        found.append((name, get_origin(annotation) or annotation, get_args(annotation)))
    return tuple(found)


@dataclass(frozen=True)
class PortHandler:
    """A method that handles each message of one input port."""

    port: str


@dataclass(frozen=True)
class ServiceHandler:
    """A method that answers the calls of one server port."""

    port: str


@dataclass(frozen=True)
class GoalHandler:
    """A method that pursues the goals of one action server port."""

    port: str


@dataclass(frozen=True)
class CancelHandler:
    """A method that cancels the goals of one action server port."""

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


def serve(port: str) -> Callable[[ServiceMethod], ServiceMethod]:
    """Decorate a method that answers the calls of the server `port`: it returns the response.

    If it raises `CairnError`, the call is refused with its text; any other exception fails the
    component. Raises `CairnError` for a method that is decorated already.
    """

    def decorate(method: ServiceMethod) -> ServiceMethod:
        return _marked(method, ServiceHandler(port))

    return decorate


def goal(port: str) -> Callable[[Method], Method]:
    """Decorate a method that begins to pursue a goal of the action server `port`.

    It gets a `ServerGoal`, which the component ends later by `succeed`, `abort` or `canceled`. If
    it raises `CairnError`, the goal is rejected, and the reason logged; any other exception fails
    the component. Raises `CairnError` for a method that is decorated already.
    """

    def decorate(method: Method) -> Method:
        return _marked(method, GoalHandler(port))

    return decorate


def cancel(port: str) -> Callable[[Method], Method]:
    """Decorate a method that begins to cancel a goal of the action server `port`.

    It gets a `ServerGoal`, which the component ends then or later, usually by `canceled`. If it
    raises `CairnError`, the goal continues. Raises `CairnError` for a method that is decorated
    already.
    """

    def decorate(method: Method) -> Method:
        return _marked(method, CancelHandler(port))

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


Handler = PortHandler | ServiceHandler | GoalHandler | CancelHandler | TimerHandler


def handlers_of(cls: type) -> dict[str, Handler]:
    """Return the decorated methods of a component class, in order of declaration, bases first.

    Raises `CairnError` for a handler of a port that is not an input, or not a server, of the class;
    for a server without a handler, and for one with several.
    """
    inputs = [port.name for port in ports_of(cls).values() if port.direction == "in"]
    servers = [one.name for one in services_of(cls).values() if one.role == "server"]
    actions = [one.name for one in actions_of(cls).values() if one.role == "server"]
    known: dict[type[Any], tuple[str, list[str]]] = {
        PortHandler: ("input", inputs),
        ServiceHandler: ("server", servers),
        GoalHandler: ("action server", actions),
        CancelHandler: ("action server", actions),
    }
    handlers: dict[str, Handler] = {}
    for base in reversed(cls.__mro__):
        for name, value in vars(base).items():
            handler: Any = getattr(value, _HANDLER_ATTRIBUTE, None)
            if handler is None:
                handlers.pop(name, None)
                continue
            kind, ports = known.get(type(handler), ("", []))
            if kind and handler.port not in ports:
                raise CairnError(
                    f"{_qualified_name(cls)}.{name}: there is no {kind} port {handler.port}; "
                    f"the {kind}s are {', '.join(ports) or 'none'}"
                )
            handlers[name] = handler
    _check_single(cls, handlers, ServiceHandler, servers, "serve")
    _check_single(cls, handlers, GoalHandler, actions, "goal")
    return handlers


def _check_single(
    cls: type,
    handlers: Mapping[str, Handler],
    kind: type[ServiceHandler | GoalHandler],
    ports: list[str],
    decorator: str,
) -> None:
    served = Counter(one.port for one in handlers.values() if isinstance(one, kind))
    for port in ports:
        if served[port] != 1:
            raise CairnError(
                f"{_qualified_name(cls)}.{port}: {served[port]} methods are decorated "
                f'@{decorator}("{port}"); decorate exactly one'
            )


def _marked(method: Marked, handler: Handler) -> Marked:
    if hasattr(method, _HANDLER_ATTRIBUTE):
        raise CairnError(
            f"{method.__qualname__} has two decorators of handlers, such as @on and @every; "
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
            declared.max_age_s,
        )
    if isinstance(declared, Out) and kind is Out:
        return PortSpec(name, "out", message, declared.qos, exclusive=declared.exclusive)
    raise _wrong_default(cls, name, kind, declared)


def _service(cls: type, name: str, kind: type, arguments: tuple[Any, ...]) -> ServiceSpec:
    service = _service_type(arguments)
    if service is None:
        raise _no_service_type(cls, name, kind)
    declared = getattr(cls, name, None)
    if declared is None:
        declared = kind()
    if isinstance(declared, Server) and kind is Server:
        return ServiceSpec(name, "server", service, max_bytes=declared.max_bytes)
    if isinstance(declared, Client) and kind is Client:
        return ServiceSpec(name, "client", service, declared.optional)
    raise _wrong_default(cls, name, kind, declared)


def _service_type(arguments: tuple[Any, ...]) -> type[Service[Any, Any]] | None:
    """Return the service of which these are request and response; None if they are not."""
    try:
        name = type_name(arguments[0])
        service = interface(name.removesuffix("_Request"))
    except (IndexError, TypeError, AttributeError, DefinitionError):
        return None
    if not issubclass(service, Service) or arguments != (service.Request, service.Response):
        return None
    return service


def _action(cls: type, name: str, kind: type, arguments: tuple[Any, ...]) -> ActionSpec:
    action = _action_type(arguments)
    if action is None:
        raise _no_action_type(cls, name, kind)
    declared = getattr(cls, name, None)
    if declared is None:
        declared = kind()
    if isinstance(declared, ActionServer) and kind is ActionServer:
        return ActionSpec(name, "server", action)
    if isinstance(declared, ActionClient) and kind is ActionClient:
        return ActionSpec(name, "client", action, declared.optional)
    raise _wrong_default(cls, name, kind, declared)


def _action_type(arguments: tuple[Any, ...]) -> type[Action[Any, Any, Any]] | None:
    """Return the action of which these are goal, result and feedback; None if they are not."""
    try:
        action = interface(type_name(arguments[0]).removesuffix("_Goal"))
    except (IndexError, TypeError, AttributeError, DefinitionError):
        return None
    if not issubclass(action, Action):
        return None
    return action if arguments == (action.Goal, action.Result, action.Feedback) else None


def _no_action_type(cls: type, name: str, kind: type) -> CairnError:
    return CairnError(
        f"{_qualified_name(cls)}.{name}: the port has no action type; annotate it with the three "
        f"classes of one action, as in `{name}: {kind.__name__}[Spin.Goal, Spin.Result, "
        "Spin.Feedback]`"
    )


def _wrong_default(cls: type, name: str, kind: type, declared: object) -> CairnError:
    owner = next(base for base in cls.__mro__ if name in vars(base))
    if name not in vars(owner).get("__annotations__", {}):
        return CairnError(
            f"{_qualified_name(cls)}.{name}: {owner.__name__} uses the name {name} itself; "
            "give the port another name"
        )
    return CairnError(
        f"{_qualified_name(cls)}.{name}: annotated {kind.__name__}, but its default is "
        f"{type(declared).__name__}; give {kind.__name__}(...) or no default"
    )


def _unannotated(cls: type, known: Collection[str], kinds: Any) -> dict[str, Any]:
    """Return the ports of these kinds that a class or its bases define without an annotation."""
    return {
        name: value
        for base in cls.__mro__
        for name, value in vars(base).items()
        if isinstance(value, kinds) and name not in known
    }


def _no_service_type(cls: type, name: str, kind: type) -> CairnError:
    return CairnError(
        f"{_qualified_name(cls)}.{name}: the port has no service type; annotate it with the two "
        f"classes of one service, as in `{name}: {kind.__name__}[Trigger.Request, "
        "Trigger.Response]`"
    )


def _check_max_bytes(kind: str, max_bytes: int | None) -> None:
    if max_bytes is not None and not 1 <= max_bytes <= LONGEST_MAX_BYTES:
        raise CairnError(
            f"{kind}(max_bytes={max_bytes}): a limit is from 1 to {LONGEST_MAX_BYTES:,} bytes"
        )


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
