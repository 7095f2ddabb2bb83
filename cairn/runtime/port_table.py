"""The ports of one running component: publishes, subscribes, delivers messages, counts them."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from cairn.bus.bus import Node, full_name
from cairn.runtime.action_ports import ActionClientPort, ActionServerPort
from cairn.runtime.call_log import CallLog
from cairn.runtime.component import Component
from cairn.runtime.input_ages import InputAges
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.loop import Scheduler
from cairn.runtime.parameters import ServiceIntrospection
from cairn.runtime.port_owner import PortOwner
from cairn.runtime.ports import (
    BoundIn,
    CancelHandler,
    GoalHandler,
    PortHandler,
    ServiceHandler,
    TimerHandler,
    actions_of,
    handlers_of,
    ports_of,
    services_of,
)
from cairn.runtime.service_ports import ClientPort, ServerPort, answering
from cairn.runtime.topic_ports import InputPort, OutputPort
from cairn.schemas.cairn_msgs import PortStatus
from cairn.schemas.message import fields_of, type_name


class PortTable:
    """Binds the ports declared by a component's class to the bus."""

    def __init__(
        self,
        component: Component,
        owner: PortOwner,
        node: Node,
        scheduler: Scheduler,
        launch: LaunchRequest,
        call_log: CallLog | None = None,
        clock_problem: Callable[[str], str] = lambda _: "",
    ) -> None:
        """Bind the ports; `launch` gives their topics, and the writers of exclusive ones.

        `clock_problem` returns why stamps of a machine of the robot cannot be used, "" if they can.
        """
        self._component = component
        elsewhere = {} if launch.context.simulated_time else launch.context.remote_topics
        handlers = handlers_of(type(component))
        self._timers = [
            (name, handler.period_ns, getattr(component, name))
            for name, handler in handlers.items()
            if isinstance(handler, TimerHandler)
        ]
        self._inputs: list[InputPort] = []
        self._outputs: list[OutputPort] = []
        bound: dict[str, BoundIn[Any]] = {}
        ages: dict[str, float] = {}
        for spec in ports_of(type(component)).values():
            name = launch.spec.topics.get(spec.name, spec.name)
            topic = full_name(launch.context.robot, name)
            exclusive = launch.exclusive(topic)
            if spec.direction == "in":
                calls = [
                    (name, getattr(component, name))
                    for name, handler in handlers.items()
                    if isinstance(handler, PortHandler) and handler.port == spec.name
                ]
                if not spec.exclusive:
                    exclusive = None
                elif exclusive is None and launch.context.exclusive_topics is not None:
                    owner.log.warning(
                        "port %s: accepts every publisher on %s, although it is exclusive: the "
                        "topic is listed under external_topics, and no component publishes it",
                        spec.name, topic,
                    )  # fmt: skip
                machine = elsewhere.get(topic)
                problem = None if machine is None else partial(clock_problem, machine)
                port = InputPort(
                    spec, topic, owner, node, scheduler, calls, exclusive, call_log, problem
                )
                setattr(component, spec.name, port.bound)
                self._inputs.append(port)
                bound[spec.name] = port.bound
                if spec.max_age_s is not None:
                    ages[spec.name] = spec.max_age_s
            else:
                output = OutputPort(component.name, spec, topic, owner, node, exclusive, call_log)
                setattr(component, spec.name, output.bound)
                self._outputs.append(output)

        self._ages = InputAges(component, bound, ages | launch.spec.max_age_s)
        self._servers: list[ServerPort] = []
        self._clients: list[ClientPort] = []
        self._bind_services(owner, node, scheduler, launch, call_log)
        self._action_servers: list[ActionServerPort] = []
        self._bind_actions(owner, node, scheduler, launch, call_log)

    def _bind_services(
        self,
        owner: PortOwner,
        node: Node,
        scheduler: Scheduler,
        launch: LaunchRequest,
        call_log: CallLog | None,
    ) -> None:
        component = self._component
        methods = _methods(component, ServiceHandler)
        for spec in services_of(type(component)).values():
            service = full_name(launch.context.robot, launch.spec.topics.get(spec.name, spec.name))
            if spec.role == "server":
                name, method = methods[spec.name]
                answer = answering(method, service)
                where = f"{name} (service {spec.name})"
                server = ServerPort(spec, service, owner, node, scheduler, where, answer, call_log)
                setattr(component, spec.name, server.bound)
                self._servers.append(server)
            else:
                client = ClientPort(component.name, spec, service, owner, node, scheduler, call_log)
                setattr(component, spec.name, client.bound)
                self._clients.append(client)

    def _bind_actions(
        self,
        owner: PortOwner,
        node: Node,
        scheduler: Scheduler,
        launch: LaunchRequest,
        call_log: CallLog | None,
    ) -> None:
        component = self._component
        goals, cancels = _methods(component, GoalHandler), _methods(component, CancelHandler)
        for spec in actions_of(type(component)).values():
            action = full_name(launch.context.robot, launch.spec.topics.get(spec.name, spec.name))
            if spec.role == "server":
                on_cancel = cancels[spec.name][1] if spec.name in cancels else None
                server = ActionServerPort(
                    component, spec, action, owner, node, scheduler, goals[spec.name][1], on_cancel,
                    call_log,
                )  # fmt: skip
                setattr(component, spec.name, server.bound)
                self._action_servers.append(server)
                self._servers += server.servers
                self._outputs += server.outputs
            else:
                client = ActionClientPort(
                    component, spec, action, owner, node, scheduler, launch, call_log
                )
                setattr(component, spec.name, client.bound)
                self._clients += client.clients
                self._inputs.append(client.feedback)

    def introspect(self, introspection: ServiceIntrospection) -> None:
        """Choose what is published of the calls of all services and actions."""
        ends: list[ServerPort | ClientPort] = [*self._servers, *self._clients]
        for end in ends:
            end.events.configure(introspection)

    def advertise(self) -> None:
        """Open the publishers of the outputs."""
        for output in self._outputs:
            output.open()

    def subscribe(self) -> None:
        """Open the subscriptions of the inputs, the servers and the clients."""
        ends: list[InputPort | ClientPort | ServerPort] = [
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
        ends: list[InputPort | ClientPort | ServerPort] = [
            *self._inputs, *self._servers, *self._clients,
        ]  # fmt: skip
        for end in ends:
            end.close()

    def reset(self) -> None:
        """Close the publishers and clear the latest messages."""
        for output in self._outputs:
            output.close()
        for port in self._inputs:
            port.bound.set_latest(None)

    def watch_ages(self) -> None:
        """Count the ages of the inputs from now on."""
        self._ages.start()

    def timers(self) -> Iterator[tuple[str, int, Callable[[], None]]]:
        """Yield the periodic handlers: name, period [ns], method."""
        yield from self._timers
        if self._ages.period_ns:
            yield "ages of inputs", self._ages.period_ns, self._ages.check

    def outputs_with(self, message: str) -> list[str]:
        """Return the outputs whose messages have the type of that name, or a field of it."""
        return [
            output.spec.name for output in self._outputs if _contains(output.spec.message, message)
        ]

    def status(self) -> tuple[PortStatus, ...]:
        """Return the counters of every port."""
        return (
            *(port.status() for port in self._inputs),
            *(output.status() for output in self._outputs),
            *(server.status() for server in self._servers),
            *(client.status() for client in self._clients),
        )


def _methods(
    component: Component, kind: type[ServiceHandler | GoalHandler | CancelHandler]
) -> dict[str, tuple[str, Callable[..., Any]]]:
    """Return the names and methods of the handlers of a kind, by port."""
    return {
        handler.port: (name, getattr(component, name))
        for name, handler in handlers_of(type(component)).items()
        if isinstance(handler, kind)
    }


def _contains(message: type[Any], name: str) -> bool:
    return type_name(message) == name or any(
        isinstance(field.element, type) and _contains(field.element, name)
        for field in fields_of(message)
    )
