"""Decorators that say which method handles which port, and which runs how often."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from cairn.clock import SECOND
from cairn.errors import CairnError
from cairn.runtime.ports import ports_of

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
