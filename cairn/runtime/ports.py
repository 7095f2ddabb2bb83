"""The ports that a component class declares, read from its annotations."""

import inspect
import typing
from collections.abc import Callable, Collection
from copy import copy
from functools import cache
from typing import Annotated, Any, get_args, get_origin

from cairn.errors import CairnError
from cairn.runtime.action_ports import ActionClient, ActionServer
from cairn.runtime.port import Port
from cairn.runtime.service_ports import Client, Server
from cairn.runtime.topic_ports import In, Out
from cairn.schemas.definitions import DefinitionError
from cairn.schemas.interfaces import interface
from cairn.schemas.message import Action, Service, type_name

ServicePort = Server[Any, Any] | Client[Any, Any]
ActionPort = ActionServer[Any, Any, Any] | ActionClient[Any, Any, Any]


def ports_of(cls: type) -> dict[str, In[Any] | Out[Any]]:
    """Return the ports that a component class and its bases declare, in order of declaration.

    Raises `CairnError` for a port without a message type, whose message class is not one of
    `cairn.schemas.message`, or whose default is not a port of the annotated direction.
    """
    return _declared(
        cls, (In, Out), _message_type, "message type; annotate it, as in `{port}[LaserScan]`"
    )


def services_of(cls: type) -> dict[str, ServicePort]:
    """Return the servers and clients that a component class and its bases declare, in order.

    Raises `CairnError` for one whose classes are not the request and response of one service, or
    whose default is not a port of the annotated kind.
    """
    return _declared(
        cls,
        (Server, Client),
        _service_type,
        "service type; annotate it with the two classes of one service, as in "
        "`{port}[Trigger.Request, Trigger.Response]`",
    )


def actions_of(cls: type) -> dict[str, ActionPort]:
    """Return the action servers and clients that a component class and its bases declare.

    Raises `CairnError` for one whose classes are not goal, result and feedback of one action, or
    whose default is not a port of the annotated kind.
    """
    return _declared(
        cls,
        (ActionServer, ActionClient),
        _action_type,
        "action type; annotate it with the three classes of one action, as in "
        "`{port}[Spin.Goal, Spin.Result, Spin.Feedback]`",
    )


def qualified_name(cls: type) -> str:
    """Return a class's name with that of its module, for messages."""
    return f"{cls.__module__}.{cls.__qualname__}"


def _declared(
    cls: type,
    kinds: Collection[type[Port]],
    type_in: Callable[[tuple[Any, ...]], type | None],
    remedy: str,
) -> dict[str, Any]:
    """Return new ports as a class declares them, with their names and types.

    `type_in` returns the type that the arguments of an annotation have, None if they have none;
    `remedy` says then what is missing.
    """
    ports = {}
    for name, kind, arguments in _annotated(cls):
        if kind in kinds:
            try:
                found = type_in(arguments)
            except TypeError as error:
                raise CairnError(f"{qualified_name(cls)}.{name}: {error}") from error
            if found is None:
                raise _no_type(cls, name, kind, remedy)
            default = getattr(cls, name, None)
            port = kind() if default is None else copy(default)
            if not isinstance(port, kind):
                raise _wrong_default(cls, name, kind, port)
            ports[name] = port.declare(name, found)
    for base in cls.__mro__:
        for name, value in vars(base).items():
            if type(value) in kinds and name not in ports:
                raise _no_type(cls, name, type(value), remedy)
    return ports


@cache
def _annotated(cls: type) -> tuple[tuple[str, Any, tuple[Any, ...]], ...]:
    """Return the annotations of a class and its bases: name, generic class, type arguments."""
    try:
        hints = typing.get_type_hints(cls, include_extras=True)
    except (NameError, TypeError) as error:
        raise CairnError(
            f"{qualified_name(cls)}: its annotations cannot be evaluated ({error}); import at "
            "module level, outside `if TYPE_CHECKING`, every name that the class body annotates"
        ) from error
    found = []
    for name, hint in hints.items():
        annotation = get_args(hint)[0] if get_origin(hint) is Annotated else hint
        found.append((name, get_origin(annotation) or annotation, get_args(annotation)))
    return tuple(found)


def _message_type(arguments: tuple[Any, ...]) -> type | None:
    """Return the message class; raises `TypeError` for a class of another kind."""
    if not arguments or not isinstance(arguments[0], type):
        return None
    message = arguments[0]
    try:
        type_name(message)
    except TypeError as error:
        raise TypeError(
            f"{qualified_name(message)} is not a message; use a class decorated with @message of "
            "cairn.schemas.message"
        ) from error
    return message


def _service_type(arguments: tuple[Any, ...]) -> type[Service[Any, Any]] | None:
    """Return the service of which these are request and response; None if they are not."""
    try:
        service = interface(type_name(arguments[0]).removesuffix("_Request"))
    except (IndexError, TypeError, AttributeError, DefinitionError):
        return None
    if not issubclass(service, Service) or arguments != (service.Request, service.Response):
        return None
    return service


def _action_type(arguments: tuple[Any, ...]) -> type[Action[Any, Any, Any]] | None:
    """Return the action of which these are goal, result and feedback; None if they are not."""
    try:
        action = interface(type_name(arguments[0]).removesuffix("_Goal"))
    except (IndexError, TypeError, AttributeError, DefinitionError):
        return None
    if not issubclass(action, Action):
        return None
    return action if arguments == (action.Goal, action.Result, action.Feedback) else None


def _no_type(cls: type, name: str, kind: type, remedy: str) -> CairnError:
    what = remedy.format(port=f"{name}: {kind.__name__}")
    return CairnError(f"{qualified_name(cls)}.{name}: the port has no {what}")


def _wrong_default(cls: type, name: str, kind: type, declared: object) -> CairnError:
    owner = next(base for base in cls.__mro__ if name in vars(base))
    if name not in inspect.get_annotations(owner):
        return CairnError(
            f"{qualified_name(cls)}.{name}: {owner.__name__} uses the name {name} itself; "
            "give the port another name"
        )
    return CairnError(
        f"{qualified_name(cls)}.{name}: annotated {kind.__name__}, but its default is "
        f"{type(declared).__name__}; give {kind.__name__}(...) or no default"
    )
