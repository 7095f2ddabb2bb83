"""The component that gives topics, services and actions of a robot their ROS names."""

from __future__ import annotations

from collections.abc import Callable

from cairn import RELIABLE, SECOND, Component, In, Out, every, from_ns, on, to_ns
from cairn.bus.actions import RESULT_TIMEOUT_S
from cairn.bus.bus import Subscription
from cairn.bus.keys import ROS_NAMES, EndpointEntity
from cairn.bus.zenoh_bus import ZenohBus
from cairn.components.ros_interface.diagnostics import diagnostic_status
from cairn.components.ros_interface.static_transforms import StaticTransforms
from cairn.deployment.model import ROOT, Deployment
from cairn.deployment.ros_name_mapping import (
    RosService,
    RosTopic,
    ros_name,
    ros_services,
    ros_topics,
)
from cairn.runtime.component import ComponentContext
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.message import InvalidMessage
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage

_SILENT_NS = 5 * SECOND  # a component publishes its status four times a second


class RosNames(Component):
    """Passes messages and calls on between the robot's names and those without its name.

    A deployment with `ros_names: true` has this component without naming it. Messages are passed on
    while something subscribes to the other name, latched ones always. It also publishes the state
    of all components on `diagnostics`.
    """

    clock_source = "system"

    component_status: In[ComponentStatus] = In(qos=RELIABLE.with_depth(500), optional=True)
    diagnostics: Out[DiagnosticArray]

    def on_activate(self) -> None:
        """Join the ROS names."""
        context = self._context
        deployment = Deployment.model_validate_json(context.launch.context.deployment)
        self._robot = deployment.robot.name
        self._members = {ROOT, *(member.name for member in deployment.members())}
        self._statuses: dict[str, ComponentStatus] = {}
        self._topics = [_Topic(context, one) for one in ros_topics(deployment)]
        self._services = [_Service(context, one) for one in ros_services(deployment)]
        self.follow_subscribers()
        self._stop_watching: Callable[[], None] = lambda: None
        if isinstance(context.bus, ZenohBus):  # in lockstep there is no other robot
            topic = ros_name(self.diagnostics.topic.rpartition("/")[2])
            self._stop_watching = context.bus.graph.watch(topic, self._check_robot)

    def on_deactivate(self) -> None:
        """Leave the ROS names."""
        self._stop_watching()
        for topic in self._topics:
            topic.close()
        for service in self._services:
            service.close()

    @on("component_status")
    def on_component_status(self, status: ComponentStatus) -> None:
        """Keep the newest status of each component."""
        if status.component in self._members:
            self._statuses[status.component] = status

    @every(hz=4)
    def follow_subscribers(self) -> None:
        """Read the topics whose ROS names have subscribers, and no others."""
        for topic in self._topics:
            topic.follow()

    @every(hz=1)
    def publish_diagnostics(self) -> None:
        """Publish the state of all components."""
        now = self.clock.now()
        statuses = tuple(
            diagnostic_status(
                self._robot, status, is_silent=now - to_ns(status.header.stamp) > _SILENT_NS
            )
            for _, status in sorted(self._statuses.items())
        )
        self.diagnostics.publish(
            DiagnosticArray(header=Header(stamp=from_ns(now)), status=statuses)
        )

    def _check_robot(self, endpoint: EndpointEntity) -> None:
        """Warn of another robot that has ROS names; on a thread of the bus."""
        robot, _, name = endpoint.node.name.rpartition("/")
        if name == ROS_NAMES and endpoint.node.name != f"/{self._robot}/{self.name}":
            self.log.warning(
                "robot %s has ROS names in this domain, too, so that /tf and actions are those of "
                "both robots; set ros_names: false for one of them, or another domain",
                robot.strip("/"),
            )


class _Topic:
    """Passes on the messages of one topic."""

    def __init__(self, context: ComponentContext, topic: RosTopic) -> None:
        self._context = context
        self._topic = topic
        self._merges = topic.message is TFMessage and topic.qos.latched
        qos = topic.qos.with_depth(1) if self._merges else topic.qos
        self._publisher = context.node.advertise(topic.target, topic.message, qos)
        self._subscription: Subscription | None = None
        self._static = StaticTransforms()

    def follow(self) -> None:
        """Subscribe while there are subscribers."""
        if self._publisher.has_subscribers:
            if self._subscription is None:
                self._subscription = self._subscribe()
        elif self._subscription is not None:
            self._subscription.close()
            self._subscription = None

    def close(self) -> None:
        """End both sides."""
        if self._subscription is not None:
            self._subscription.close()
        self._publisher.close()

    def _subscribe(self) -> Subscription:
        topic, context = self._topic, self._context
        exclusive = context.launch.exclusive(topic.source) if topic.is_exclusive else None
        return context.node.subscribe(
            topic.source,
            topic.message,
            topic.qos,
            lambda: context.post(self._pass_on),
            exclusive,
            topic.max_bytes,
        )

    def _pass_on(self) -> None:
        if self._subscription is None:
            return
        try:
            message = self._subscription.take()
        except InvalidMessage as error:
            self._context.log.warning("dropped a message on %s: %s", self._topic.source, error)
            return
        if message is None:  # a newer one has displaced it
            return
        self._publisher.publish(self._static.add(message) if self._merges else message)


class _Service:
    """Passes on the calls of one service."""

    def __init__(self, context: ComponentContext, service: RosService) -> None:
        self._context = context
        self._service = service
        post = context.post
        self._client = context.node.client(service.server, service.service, post)
        self._server = context.node.serve(
            service.name, service.service, lambda: post(self._pass_on)
        )

    def close(self) -> None:
        """End both sides."""
        self._server.close()
        self._client.close()

    def _pass_on(self) -> None:
        try:
            call = self._server.take()
        except InvalidMessage as error:
            self._context.log.warning("refused a call of %s: %s", self._service.name, error)
            return
        if call is not None:
            self._client.call(
                call.request, call.reply, lambda error: call.refuse(str(error)), RESULT_TIMEOUT_S
            )
