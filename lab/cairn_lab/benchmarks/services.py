"""Services and actions: round trip compared with a raw query of zenoh-python, feedback at 50 Hz."""

import json
import multiprocessing
import statistics
import time
from multiprocessing.connection import Connection
from typing import Any

import zenoh

from cairn import (
    ActionClient,
    ActionServer,
    Client,
    Component,
    Server,
    ServerGoal,
    ServiceError,
    every,
    goal,
    serve,
)
from cairn.bus.codec import Codec
from cairn.schemas.example_interfaces.action import Fibonacci
from cairn.schemas.example_interfaces.srv import AddTwoInts
from cairn.testing.launching import free_port
from cairn_lab.benchmarks.result import Metric
from cairn_lab.benchmarks.roundtrip import raw_session, summary
from cairn_lab.benchmarks.running import results, run_deployment

ROUNDS = 5
LIMIT = 1.5
CALLS = 1500
FEEDBACK = 500
_HERE = "cairn_lab.benchmarks.services"


class Adder(Component):
    """Adds two numbers."""

    add: Server[AddTwoInts.Request, AddTwoInts.Response]

    @serve("add")
    def on_add(self, request: AddTwoInts.Request) -> AddTwoInts.Response:
        """Return the sum."""
        return AddTwoInts.Response(sum=request.a + request.b)


class Caller(Component):
    """Calls the adder, one call after the other."""

    add: Client[AddTwoInts.Request, AddTwoInts.Response]

    def on_activate(self) -> None:
        """Call for the first time."""
        self._times: list[float] = []
        self.schedule(self.clock.now(), self._call)

    def _call(self) -> None:
        self._sent = time.perf_counter()
        self.add.call(AddTwoInts.Request(a=1, b=2), self._answered, self._failed)

    def _failed(self, error: ServiceError) -> None:
        self.finish(f"no answer: {error}", success=False)

    def _answered(self, _: AddTwoInts.Response) -> None:
        self._times.append(time.perf_counter() - self._sent)
        if len(self._times) < CALLS:
            self._call()
        else:
            self.log.info("RESULT %s", json.dumps(summary(self._times[CALLS // 10 :])))
            self.finish("measured")


class Producer(Component):
    """Sends feedback 50 times a second."""

    fibonacci: ActionServer[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]
    _goal: ServerGoal[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback] | None = None
    _sent = 0

    @goal("fibonacci")
    def begin(self, goal: ServerGoal[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]) -> None:
        """Begin with the feedback."""
        self._goal, self._sent = goal, 0

    @every(hz=50)
    def feed(self) -> None:
        """Send one feedback; succeed after the last."""
        if self._goal is None:
            return
        self._sent += 1
        self._goal.publish_feedback(
            Fibonacci.Feedback(sequence=[self._sent])  # type: ignore[arg-type]
        )
        if self._sent == self._goal.goal.order:
            self._goal.succeed(Fibonacci.Result())
            self._goal = None


class Consumer(Component):
    """Counts the feedback that arrives."""

    fibonacci: ActionClient[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]

    def on_activate(self) -> None:
        """Send a goal."""
        self._received: list[int] = []
        self.schedule(self.clock.now(), self._send)

    def _send(self) -> None:
        self.fibonacci.send(
            Fibonacci.Goal(order=FEEDBACK),
            self._ended,
            on_feedback=lambda one: self._received.append(int(one.sequence[0])),
        )

    def _ended(self, status: int, _: Fibonacci.Result) -> None:
        # The result may overtake the last feedback, which travels on a topic.
        self.schedule(self.clock.now() + 500_000_000, lambda: self._report(status))

    def _report(self, status: int) -> None:
        in_order = self._received == sorted(self._received)
        count = len(self._received)
        self.log.info("RESULT %s", json.dumps({"status": status, "count": count, "ok": in_order}))
        self.finish("measured")


def through_ports(server: str, client: str) -> dict[str, Any]:
    """Return what a client reports that runs beside a server, each in its process."""
    output = run_deployment(
        {
            "server": {"plugin": f"{_HERE}:{server}"},
            "client": {
                "plugin": f"{_HERE}:{client}",
                "restart": "transient",
                "significant": True,
            },
        },
        120,
    )
    return results(output)[0]


def raw_query(endpoint: str) -> float:
    """Return the median round trip [us] of a query of zenoh-python with the same payload."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_answer_queries, args=(endpoint, theirs))
    process.start()
    try:
        if not ours.poll(30) or ours.recv() != "ready":
            raise RuntimeError("the other process did not start")
        data = Codec().encode(AddTwoInts.Request(a=1, b=2))
        times = []
        with raw_session(connect=endpoint) as session:
            for _ in range(CALLS):
                begin = time.perf_counter()
                for reply in session.get("bench/add", payload=data, timeout=5.0):
                    if reply.ok is None:
                        raise RuntimeError("a query was not answered")
                    reply.ok.payload.to_bytes()
                times.append(time.perf_counter() - begin)
        return summary(times[CALLS // 10 :])["median"]
    finally:
        ours.send("end")
        process.join(10)
        process.kill()


def _answer_queries(endpoint: str, parent: Connection) -> None:
    data = Codec().encode(AddTwoInts.Response(sum=3))

    def answer(query: zenoh.Query) -> None:
        with query:
            if query.payload is not None:
                query.payload.to_bytes()
            query.reply(query.key_expr, data)

    with raw_session(listen=endpoint) as session:
        queryable = session.declare_queryable("bench/add", answer, complete=True)
        parent.send("ready")
        parent.poll(60)
        queryable.undeclare()


def measure() -> list[Metric]:
    """Measure the ratio of the medians, and what arrives of the feedback."""
    ours, raw = [], []
    for _ in range(ROUNDS):
        raw.append(raw_query(f"tcp/127.0.0.1:{free_port()}"))
        ours.append(float(through_ports("Adder", "Caller")["median"]))
    mine, theirs = statistics.median(ours), statistics.median(raw)
    feedback = through_ports("Producer", "Consumer")
    lost = FEEDBACK - int(feedback["count"])
    return [
        Metric(
            "round trip of a service: ports / raw query over loopback TCP",
            mine / theirs,
            "x",
            at_most=LIMIT,
            note=f"{mine:.0f} us / {theirs:.0f} us",
        ),
        Metric(
            "feedback of an action at 50 Hz that is lost or out of order",
            float(lost + (not feedback["ok"])),
            f"of {FEEDBACK}",
            at_most=0,
            note="10 s",
        ),
    ]
