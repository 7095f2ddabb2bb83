"""The handlers of a component: the methods that its class decorates with `@on`, `@every`, ..."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

from cairn.errors import CairnError
from cairn.runtime.ports import actions_of, ports_of, qualified_name, services_of
from cairn.system.clock import SECOND

Method = TypeVar("Method", bound=Callable[..., None])
ServiceMethod = TypeVar("ServiceMethod", bound=Callable[..., Any])
Marked = TypeVar("Marked", bound=Callable[..., Any])

Decorator = Literal["on", "serve", "goal", "cancel", "every"]

_HANDLER_ATTRIBUTE = "_cairn_handler"


@dataclass(frozen=True)
class Handler:
    """How a method is decorated: when it is called."""

    decorator: Decorator
    port: str = ""
    """Its port; "" for `@every`."""
    period_ns: int = 0
    """Its period in the component's own time [ns], for `@every`."""


def on(port: str) -> Callable[[Method], Method]:
    """Decorate a method to be called with each message of the input `port`, while active.

    Raises `CairnError` for a method that is decorated already.
    """
    return lambda method: _marked(method, Handler("on", port))


def serve(port: str) -> Callable[[ServiceMethod], ServiceMethod]:
    """Decorate a method that answers the calls of the server `port`: it returns the response.

    If it raises `CairnError`, the call is refused with its text; any other exception fails the
    component. Raises `CairnError` for a method that is decorated already.
    """
    return lambda method: _marked(method, Handler("serve", port))


def goal(port: str) -> Callable[[Method], Method]:
    """Decorate a method that begins to pursue a goal of the action server `port`.

    It gets a `ServerGoal`, which the component ends later by `succeed`, `abort` or `canceled`. If
    it raises `CairnError`, the goal is rejected, and the reason logged; any other exception fails
    the component. Raises `CairnError` for a method that is decorated already.
    """
    return lambda method: _marked(method, Handler("goal", port))


def cancel(port: str) -> Callable[[Method], Method]:
    """Decorate a method that begins to cancel a goal of the action server `port`.

    It gets a `ServerGoal`, which the component ends then or later, usually by `canceled`. If it
    raises `CairnError`, the goal continues. Raises `CairnError` for a method that is decorated
    already.
    """
    return lambda method: _marked(method, Handler("cancel", port))


def every(*, hz: float) -> Callable[[Method], Method]:
    """Decorate a method to be called `hz` times per second of the component's clock, while active.

    Missed periods are skipped. Raises `CairnError` unless 0 < hz <= 1000, and for a method that
    is decorated already.
    """
    if not 0 < hz <= 1000:
        raise CairnError(f"@every(hz={hz}): a rate must be above 0 and at most 1000 Hz")
    return lambda method: _marked(method, Handler("every", period_ns=round(SECOND / hz)))


def handlers_of(cls: type) -> dict[str, Handler]:
    """Return the decorated methods of a component class, in order of declaration, bases first.

    Raises `CairnError` for a handler of a port that is not an input, or not a server, of the class;
    for a server without a handler, and for one with several.
    """
    inputs = [port.name for port in ports_of(cls).values() if port.direction == "in"]
    servers = [one.name for one in services_of(cls).values() if one.role == "server"]
    actions = [one.name for one in actions_of(cls).values() if one.role == "server"]
    known = {
        "on": ("input", inputs),
        "serve": ("server", servers),
        "goal": ("action server", actions),
        "cancel": ("action server", actions),
    }
    handlers: dict[str, Handler] = {}
    for base in reversed(cls.__mro__):
        for name, value in vars(base).items():
            handler = getattr(value, _HANDLER_ATTRIBUTE, None)
            if not isinstance(handler, Handler):
                handlers.pop(name, None)
                continue
            kind, ports = known.get(handler.decorator, ("", [""]))
            if handler.port not in ports:
                raise CairnError(
                    f"{qualified_name(cls)}.{name}: there is no {kind} port {handler.port}; "
                    f"the {kind}s are {', '.join(ports) or 'none'}"
                )
            handlers[name] = handler
    _check_single(cls, handlers, "serve", servers)
    _check_single(cls, handlers, "goal", actions)
    return handlers


def _check_single(
    cls: type, handlers: Mapping[str, Handler], decorator: Decorator, ports: list[str]
) -> None:
    served = Counter(one.port for one in handlers.values() if one.decorator == decorator)
    for port in ports:
        if served[port] != 1:
            raise CairnError(
                f"{qualified_name(cls)}.{port}: {served[port]} methods are decorated "
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
