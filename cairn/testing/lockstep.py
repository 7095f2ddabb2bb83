"""The lockstep harness: test one component, or a whole deployment, in virtual time.

Virtual time advances only when the test lets it, so such a test takes almost no real time and has
the same result in every run. `ComponentHarness` runs one component whose ports the test writes and
reads; `DeploymentHarness` runs all components of a deployment file:

    base = ComponentHarness(TurtleBase, {"command_timeout_s": 0.3})
    base.publish("cmd_vel", Twist(linear=Vector3(x=0.5)))
    base.run_for(1.0)
    assert base.take("odom")[-1].twist.twist.linear.x == 0.0

    with DeploymentHarness("deploy/turtle.yaml", sets=["distance=5"]) as turtle:
        odom = turtle.read("odom", Odometry)
        turtle.run_until(lambda: len(odom.messages) > 10)
        turtle.set_parameters("wanderer", {"speed": 0.8})
        assert turtle.run_to_end().normal

Lockstep has no real processes, threads or network. For these see `cairn.testing.robot`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Generic, Self, TypeVar, cast

from cairn.bus.actions import ActionCaller, SentGoal, make_at_once
from cairn.bus.bus import Node, Publisher, ServiceError, Subscription, full_name
from cairn.bus.lockstep_bus import LockstepBus
from cairn.bus.qos import RELIABLE, Qos
from cairn.deployment.load import load_deployment
from cairn.deployment.model import Deployment
from cairn.processes.lockstep import LockstepExecutor, LockstepRun
from cairn.runtime.child_spec import ChildSpec
from cairn.runtime.component import Component
from cairn.runtime.launch_request import LaunchRequest, RunContext
from cairn.runtime.lifecycle import STATE_AFTER, LifecycleState
from cairn.runtime.ports import ports_of
from cairn.runtime.process_exit import ExitReport
from cairn.runtime.runtime import Runtime
from cairn.schemas.message import Action, Feedback, Goal, Request, Response, Result, Service
from cairn.system.clock import SECOND

C = TypeVar("C", bound=Component)
M = TypeVar("M")

EVERYTHING = Qos("reliable", "transient_local", 1_000_000)
"""Receives latched messages from before, and drops nothing."""


def _nothing() -> None:
    """Do nothing."""


class LockstepReading(Generic[M]):
    """Collects what is published on one topic; made by `Lockstep.read`.

    `messages` holds the messages received and not yet taken. It is complete at every moment, also
    within the condition of `run_until`.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        message: type[M],
        qos: Qos,
        on_message: Callable[[], object],
    ) -> None:
        self.topic = topic
        self.messages: list[M] = []
        self._on_message = on_message
        self._subscription: Subscription | None = None
        self._subscription = node.subscribe(topic, message, qos, self._receive)
        self._receive()  # latched messages arrived before the subscription existed

    def take(self) -> list[M]:
        """Return the messages received since the last call, oldest first."""
        messages, self.messages = self.messages, []
        return messages

    def close(self) -> None:
        """Unsubscribe; messages received before are kept."""
        if self._subscription is not None:
            self._subscription.close()

    def _receive(self) -> None:
        if self._subscription is None:
            return
        while (message := self._subscription.take()) is not None:
            self.messages.append(message)
            self._on_message()


class Lockstep:
    """Virtual time, and a bus in memory on which the test publishes and subscribes.

    It has no components of its own: add them with `ComponentHarness(..., beside=lockstep)`.
    Names of topics are below the robot's namespace unless they begin with `/`.
    """

    def __init__(
        self,
        start_s: float = 0.0,
        *,
        robot: str = "robot",
        executor: LockstepExecutor | None = None,
        bus: LockstepBus | None = None,
    ) -> None:
        """Begin at virtual time `start_s` [s], unless an executor is given, which has the time."""
        self.robot = robot
        self.executor = executor or LockstepExecutor(round(start_s * SECOND))
        self.bus = bus or LockstepBus(self.executor.after)
        self.node = self.bus.node(full_name(robot, "test"), _raise)
        self._writers: dict[str, Publisher] = {}
        self._goals = itertools.count(1)

    @property
    def now(self) -> float:
        """Virtual time [s]."""
        return self.executor.now() / SECOND

    @property
    def now_ns(self) -> int:
        """Virtual time [ns]."""
        return self.executor.now()

    def run_for(self, seconds: float) -> None:
        """Let virtual time advance by `seconds`, with everything that happens until then."""
        self.run_to(self.now_ns + round(seconds * SECOND))

    def run_to(self, time: int) -> None:
        """Let virtual time advance to `time` [ns], with everything that happens until then."""
        self.executor.run_to(time)

    def run_until(self, condition: Callable[[], bool], limit_s: float = 300.0) -> None:
        """Let virtual time advance until `condition()` holds; evaluate it before every event.

        Raises `AssertionError` if it does not hold within `limit_s` [s] of virtual time.
        """
        limit = self.now_ns + round(limit_s * SECOND)
        self.executor.at(limit, _nothing)
        self.executor.run(lambda: condition() or self.now_ns >= limit)
        assert condition(), f"not within {limit_s:g} s of virtual time; {self}"

    def read(
        self,
        topic: str,
        message: type[M],
        qos: Qos = EVERYTHING,
        on_message: Callable[[], object] = _nothing,
    ) -> LockstepReading[M]:
        """Subscribe to a topic; collect what is published from now on, and what is latched.

        `on_message` is called after each message.
        """
        full = full_name(self.robot, topic)
        return LockstepReading(self.node, full, message, qos, on_message)

    def publish(
        self, topic: str, *messages: Any, qos: Qos = RELIABLE, handled: bool = True
    ) -> None:
        """Publish messages; if `handled`, process them at once, without advancing virtual time.

        The test is one writer for each topic, with the QoS of its first call.
        """
        full = full_name(self.robot, topic)
        if full not in self._writers:
            self._writers[full] = self.node.advertise(full, type(messages[0]), qos)
        for message in messages:
            self._writers[full].publish(message)
        if handled:
            self.run_for(0.0)

    def call(
        self,
        service: str,
        kind: type[Service[Request, Response]],
        request: Request,
        timeout_s: float = 5.0,
    ) -> Response:
        """Call a service and let virtual time advance until it answers; return the response.

        Raises `ServiceError` if there is no server, it refuses, or does not answer in time.
        """
        self.run_for(0.0)  # a deployment has started then
        answers: list[Any] = []
        client = self.node.client(full_name(self.robot, service), kind, make_at_once)
        client.call(request, answers.append, answers.append, timeout_s)
        self.run_until(lambda: bool(answers), limit_s=timeout_s + 1.0)
        client.close()
        if isinstance(answers[0], ServiceError):
            raise answers[0]
        return cast("Response", answers[0])

    def send_goal(
        self, action: str, kind: type[Action[Goal, Result, Feedback]], goal: Goal
    ) -> SentGoal[Goal, Result, Feedback]:
        """Send a goal; what happens to it is found in the object returned, as time advances."""
        self.run_for(0.0)  # a deployment has started then
        caller = ActionCaller(
            full_name(self.robot, action),
            kind,
            lambda name, service: self.node.client(name, service, make_at_once),
        )
        feedback = self.read(
            caller.feedback_topic,
            kind.FeedbackMessage,
            on_message=lambda: [caller.receive_feedback(one) for one in feedback.take()],
        )
        sent = caller.send(next(self._goals).to_bytes(16, "big"), goal)
        self.run_for(0.0)
        return sent

    def __str__(self) -> str:
        """Describe the moment, for the message of a test that fails."""
        return f"virtual time is {self.now:.3f} s"


class ComponentHarness(Lockstep, Generic[C]):
    """Runs one component alone, active unless `activate` is False; the test has its ports.

    `publish` to one of its inputs uses the QoS of that port. All outputs are recorded from the
    beginning; `take` returns them. `published` lists the output and the virtual time [ns] of each
    message, in order of publication. `ends` holds how the component ended.
    """

    def __init__(
        self,
        component: type[C],
        parameters: Mapping[str, Any] | None = None,
        *,
        start_s: float = 0.0,
        beside: Lockstep | None = None,
        activate: bool = True,
        name: str = "component",
        topics: Mapping[str, str] | None = None,
        robot: str = "robot",
        simulated_time: bool = False,
        seed: int = 0,
        restarts: int = 0,
        max_age_s: Mapping[str, float] | None = None,
    ) -> None:
        """Construct the component with its parameters; configure and activate it.

        Args:
            component: class of the component.
            parameters: as in a deployment file.
            start_s: virtual time at the beginning [s].
            beside: share the bus and the time of another harness.
            activate: False leaves the component unconfigured; see `activate` and `request`.
            name: name of the component.
            topics: topics of its ports, where they differ from the ports' names.
            robot: namespace of its topics.
            simulated_time: whether it takes its time from the topic `clock`.
            seed: seed of its random numbers.
            restarts: how many times it has been restarted before.
            max_age_s: ages [s] from which its inputs are stale, where they differ from its class.

        Raises `CairnError` if the component cannot be constructed, configured or activated.
        """
        settings = LaunchRequest(
            name=name,
            spec=ChildSpec(
                plugin=f"{component.__module__}:{component.__qualname__}",
                parameters=dict(parameters or {}),
                topics=dict(topics or {}),
                max_age_s=dict(max_age_s or {}),
            ),
            incarnation=1 + restarts,
            context=RunContext(robot=robot, simulated_time=simulated_time, seed=seed),
        )
        if beside is None:
            super().__init__(start_s, robot=robot)
        else:
            super().__init__(robot=robot, executor=beside.executor, bus=beside.bus)
        self.published: list[tuple[str, int]] = []
        self.ends: list[ExitReport] = []
        self._topics = {name: settings.spec.topics.get(name, name) for name in ports_of(component)}
        self._inputs = {
            name: port for name, port in ports_of(component).items() if port.direction == "in"
        }
        self._outputs = {
            name: self.read(
                self._topics[name], port.interface, on_message=partial(self._note_message, name)
            )
            for name, port in ports_of(component).items()
            if port.direction == "out"
        }
        self.runtime = Runtime(
            component,
            settings,
            self.bus,
            self.executor.scheduler(),
            self.executor,
            self.ends.append,
        )
        if activate:
            self.activate()

    @property
    def component(self) -> C:
        """The component itself."""
        return cast("C", self.runtime.component)

    @property
    def state(self) -> LifecycleState:
        """The state of its life cycle."""
        return self.runtime.state

    @property
    def end(self) -> ExitReport | None:
        """How it ended, None while it runs."""
        return self.ends[0] if self.ends else None

    def activate(self) -> None:
        """Configure and activate it; raises `CairnError` if that fails."""
        self.request("configure")
        self.request("activate")

    def request(self, verb: str, **arguments: Any) -> Any:
        """Return its reply to a control request: life cycle, parameters, or one of its own.

        Raises `CairnError` if the component rejects the request.
        """
        return self.runtime.request(verb, arguments)

    def set_parameters(self, changes: Mapping[str, Any]) -> None:
        """Change parameters, all or none; raises `ParameterRejected` if it rejects them."""
        self.request("set_parameters", **changes)

    def publish(
        self, topic: str, *messages: Any, qos: Qos | None = None, handled: bool = True
    ) -> None:
        """Publish messages to one of its inputs, or to another topic; see `Lockstep.publish`."""
        port = self._inputs.get(topic)
        if qos is None:
            qos = RELIABLE if port is None else port.qos
        super().publish(self._topics.get(topic, topic), *messages, qos=qos, handled=handled)

    def take(self, port: str) -> list[Any]:
        """Return what it has published on one of its outputs since the last call."""
        return self._outputs[port].take()

    def _note_message(self, port: str) -> None:
        self.published.append((port, self.now_ns))


class DeploymentHarness(Lockstep):
    """Runs all components of a deployment; a context manager that shuts them down at its end.

    The deployment starts with the first call that needs it, so that readings opened before receive
    everything.
    """

    def __init__(
        self,
        deployment: Deployment | Path | str,
        *,
        overlays: Sequence[Path] = (),
        sets: Sequence[str] = (),
        seed: int = 0,
        beside: DeploymentHarness | None = None,
    ) -> None:
        """Load a deployment file, with overlays and `--set` values as for `cairn up`.

        `beside` shares the bus and the time of another harness, whose deployment has another
        `robot`: several robots on one bus. Raises `CairnError` if it cannot be loaded.
        """
        if not isinstance(deployment, Deployment):
            deployment = load_deployment(Path(deployment), overlays, sets)
        self.run: LockstepRun = LockstepRun(
            deployment, seed, None if beside is None else beside.run
        )
        super().__init__(robot=deployment.robot.name, executor=self.run.executor, bus=self.run.bus)
        self._started = False

    @property
    def end(self) -> ExitReport | None:
        """How the deployment ended, None while it runs."""
        return self.run.end

    def start(self) -> None:
        """Configure and activate all components, once; raises `CairnError` if that fails."""
        if not self._started:
            self._started = True
            self.run.start()

    def run_to(self, time: int) -> None:
        """Let virtual time advance to `time` [ns], with everything that happens until then."""
        self.start()
        super().run_to(time)

    def run_until(self, condition: Callable[[], bool], limit_s: float = 300.0) -> None:
        """Let virtual time advance until `condition()` holds; see `Lockstep.run_until`.

        Raises `AssertionError` at once if the deployment ends before that.
        """
        self.start()
        super().run_until(lambda: condition() or self.end is not None, limit_s)
        assert condition(), f"the condition does not hold at the deployment's end; {self}"

    def publish(
        self, topic: str, *messages: Any, qos: Qos = RELIABLE, handled: bool = True
    ) -> None:
        """Publish messages once all components are active; see `Lockstep.publish`."""
        self.start()
        super().publish(topic, *messages, qos=qos, handled=handled)

    def run_to_end(self, limit_s: float = 3600.0) -> ExitReport:
        """Let virtual time advance until the deployment ends by itself; return how it ended.

        Raises `AssertionError` if it does not end within `limit_s` [s] of virtual time.
        """
        self.run_until(lambda: self.run.end is not None, limit_s)
        assert self.run.end is not None
        return self.run.end

    def state(self, component: str) -> LifecycleState:
        """Return the state of a component's life cycle; raises `CairnError` if it does not run."""
        self.start()
        return self.run.runtime(component).state

    def request(self, component: str, verb: str, **arguments: Any) -> Any:
        """Return a component's reply to a request, after everything that it causes at once.

        A transition of the life cycle is requested of its supervisor, which holds the component in
        the new state until another one is requested. Raises `CairnError` if the component does not
        run or rejects the request.
        """
        self.start()
        runtime = self.run.runtime(component)
        if verb in STATE_AFTER:
            arguments = {"name": component, "state": STATE_AFTER[verb].value}
            runtime, verb = self.run.runtime(runtime.launch.parent), "hold"
        answer = runtime.request(verb, arguments)
        self.run_for(0.0)
        return answer

    def set_parameters(self, component: str, changes: Mapping[str, Any]) -> None:
        """Change parameters of a component, all or none; raises `ParameterRejected`."""
        self.request(component, "set_parameters", **changes)

    def suspend(self, component: str) -> None:
        """Suspend a component, as if its process were stopped (SIGSTOP)."""
        self.start()
        self.run.suspend(component)

    def shutdown(self) -> None:
        """Shut down all components cleanly, unless the deployment has ended."""
        if self._started:
            self.run.shutdown()

    def __str__(self) -> str:
        """Describe the moment, and how the deployment ended if it has."""
        ended = "" if self.end is None else f"; the deployment has ended: {self.end.reason}"
        return super().__str__() + ended

    def __enter__(self) -> Self:
        """Return itself; nothing is started yet."""
        return self

    def __exit__(self, *_: object) -> None:
        """Shut down all components."""
        self.shutdown()


def _raise(problem: str) -> None:
    raise AssertionError(problem)
