"""The ports of one running component, which its runtime opens and closes together."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from cairn.bus.bus import full_name
from cairn.runtime.action_ports import ActionServer
from cairn.runtime.component import Component, ComponentContext
from cairn.runtime.handlers import Decorator, handlers_of
from cairn.runtime.input_ages import InputAges
from cairn.runtime.parameters import ServiceIntrospection
from cairn.runtime.ports import actions_of, ports_of, services_of
from cairn.runtime.service_ports import Client, Server, answering
from cairn.runtime.topic_ports import In, Out
from cairn.schemas.cairn_msgs import PortStatus
from cairn.schemas.message import fields_of, type_name


class PortTable:
    """All ports of one running component: those that its class declares, bound to the bus."""

    def __init__(
        self,
        component: Component,
        context: ComponentContext,
        clock_problem: Callable[[str], str] = lambda _: "",
    ) -> None:
        """Bind the ports, and make them attributes of the component.

        `clock_problem` returns why stamps of a machine of the robot cannot be used, "" if they can.
        """
        self._component = component
        self._context = context
        self._clock_problem = clock_problem
        self._handlers = handlers_of(type(component))
        self._inputs: list[In[Any]] = []
        self._outputs: list[Out[Any]] = []
        self._servers: list[Server[Any, Any]] = []
        self._clients: list[Client[Any, Any]] = []
        self._action_servers: list[ActionServer[Any, Any, Any]] = []
        self._bind_topics()
        inputs = {port.name: port for port in self._inputs}
        ages = {port.name: port.max_age_s for port in self._inputs if port.max_age_s is not None}
        self._ages = InputAges(component, inputs, ages | context.launch.spec.max_age_s)
        self._bind_services()
        self._bind_actions()

    def _bind_topics(self) -> None:
        launch = self._context.launch
        elsewhere = {} if launch.context.simulated_time else launch.context.remote_topics
        for name, port in ports_of(type(self._component)).items():
            topic = self._full_name(name)
            writer = launch.exclusive(topic)
            if isinstance(port, In):
                if not port.exclusive:
                    writer = None
                elif writer is None and launch.context.exclusive_topics is not None:
                    self._context.log.warning(
                        "port %s: accepts every publisher on %s, although it is exclusive: the "
                        "topic is listed under external_topics, and no component publishes it",
                        name, topic,
                    )  # fmt: skip
                machine = elsewhere.get(topic)
                problem = None if machine is None else partial(self._clock_problem, machine)
                port.bind(self._context, topic, self._methods("on", name), writer, problem)
                self._inputs.append(port)
            else:
                port.bind(self._context, topic, writer)
                self._outputs.append(port)
            setattr(self._component, name, port)

    def _bind_services(self) -> None:
        for name, port in services_of(type(self._component)).items():
            service = self._full_name(name)
            if isinstance(port, Server):
                [(method_name, method)] = self._methods("serve", name)
                where = f"{method_name} (service {name})"
                port.bind(self._context, service, where, answering(method, service))
                self._servers.append(port)
            else:
                port.bind(self._context, service)
                self._clients.append(port)
            setattr(self._component, name, port)

    def _bind_actions(self) -> None:
        for name, port in actions_of(type(self._component)).items():
            action = self._full_name(name)
            if isinstance(port, ActionServer):
                [(_, on_goal)] = self._methods("goal", name)
                on_cancel = [method for _, method in self._methods("cancel", name)]
                port.bind(self._context, action, on_goal, on_cancel[-1] if on_cancel else None)
                self._action_servers.append(port)
                self._servers += port.servers
                self._outputs += port.outputs
            else:
                port.bind(self._context, action)
                self._clients += port.clients
                self._inputs.append(port.feedback)
            setattr(self._component, name, port)

    def _full_name(self, port: str) -> str:
        launch = self._context.launch
        return full_name(launch.context.robot, launch.spec.topics.get(port, port))

    def _methods(self, decorator: Decorator, port: str) -> list[tuple[str, Callable[..., Any]]]:
        """Return the names and methods of the handlers of a port that are decorated so."""
        return [
            (name, getattr(self._component, name))
            for name, handler in self._handlers.items()
            if (handler.decorator, handler.port) == (decorator, port)
        ]

    def introspect(self, introspection: ServiceIntrospection) -> None:
        """Choose what is published of the calls of all services and actions."""
        ends: list[Server[Any, Any] | Client[Any, Any]] = [*self._servers, *self._clients]
        for end in ends:
            end.events.configure(introspection)

    def advertise(self) -> None:
        """Open the publishers of the outputs."""
        for output in self._outputs:
            output.open()

    def subscribe(self) -> None:
        """Open the subscriptions of the inputs, the servers and the clients."""
        ends: list[In[Any] | Client[Any, Any] | Server[Any, Any]] = [
            *self._inputs, *self._clients, *self._servers,
        ]  # fmt: skip
        for end in ends:
            end.open()

    def drain(self) -> None:
        """Handle the messages that are pending."""
        for port in self._inputs:
            port.drain()

    def unsubscribe(self) -> None:
        """Close the subscriptions, the servers and the clients; abort the goals of actions."""
        for action in self._action_servers:
            action.abort_goals()
        ends: list[In[Any] | Client[Any, Any] | Server[Any, Any]] = [
            *self._inputs, *self._servers, *self._clients,
        ]  # fmt: skip
        for end in ends:
            end.close()

    def reset(self) -> None:
        """Close the publishers and clear the latest messages."""
        for output in self._outputs:
            output.close()
        for port in self._inputs:
            port.forget()

    def watch_ages(self) -> None:
        """Count the ages of the inputs from now on."""
        self._ages.start()

    def timers(self) -> Iterator[tuple[str, int, Callable[[], None]]]:
        """Yield the periodic handlers: name, period [ns], method."""
        for name, handler in self._handlers.items():
            if handler.decorator == "every":
                yield name, handler.period_ns, getattr(self._component, name)
        if self._ages.period_ns:
            yield "ages of inputs", self._ages.period_ns, self._ages.check

    def outputs_with(self, message: str) -> list[str]:
        """Return the outputs whose messages have the type of that name, or a field of it."""
        return [output.name for output in self._outputs if _contains(output.interface, message)]

    def status(self) -> tuple[PortStatus, ...]:
        """Return the counters of every port."""
        return (
            *(port.status() for port in self._inputs),
            *(output.status() for output in self._outputs),
            *(server.status() for server in self._servers),
            *(client.status() for client in self._clients),
        )


def _contains(message: type[Any], name: str) -> bool:
    return type_name(message) == name or any(
        isinstance(field.element, type) and _contains(field.element, name)
        for field in fields_of(message)
    )
