"""`cairn topic list|echo|hz`: what passes on the bus."""

import itertools
import json as json_module
import queue
import statistics
import time
from typing import Annotated, Any

import typer
import yaml

from cairn.bus import keys
from cairn.bus.codec import Codec, to_plain
from cairn.cli import graph
from cairn.cli.connection import (
    DEFAULT_CONNECT,
    Connect,
    Connection,
    Domain,
    Json,
    Robot,
    attachment_of,
    connected,
    resolve,
)
from cairn.cli.message_types import find_message
from cairn.cli.tables import line, print_json, show
from cairn.errors import CairnError
from cairn.schemas.message import InvalidMessage

_SHOWN = 36  # elements of a sequence: a covariance is whole

app = typer.Typer(help="List, print and time the messages on the bus.")
Topic = Annotated[str, typer.Argument(help="As in `pose` or `/robot/pose`.", metavar="TOPIC")]
Wait = Annotated[float, typer.Option(min=0.1, help="Give up after so long without a message [s].")]


@app.command("list")
def list_(
    connect: Connect = DEFAULT_CONNECT, domain: Domain = 0, robot: Robot = "", json: Json = False
) -> None:
    """List the topics with message type and numbers of writers and readers."""
    with connected(connect, domain) as connection:
        rows = graph.rows(connection.endpoints(), robot)
    counted = [
        {**row, "writers": len(row["writers"]), "readers": len(row["readers"])} for row in rows
    ]
    columns = ("topic", "type", "writers", "readers")
    show(counted, columns, as_json=json, nothing="there is no topic")


@app.command()
def echo(
    topic: Topic,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: Robot = "",
    count: Annotated[int | None, typer.Option(min=1, help="Stop after so many messages.")] = None,
    full: Annotated[
        bool, typer.Option("--full", help="Print long sequences whole, as JSON always has them.")
    ] = False,
    wait: Wait = 10.0,
    json: Annotated[bool, typer.Option("--json", help="Print a line of JSON each.")] = False,
) -> None:
    """Print the messages of a topic, the latched one first."""
    codec = Codec()
    with connected(connect, domain) as connection:
        endpoint = _endpoint(connection, topic, robot)
        message = find_message(endpoint.type_name)
        latched = endpoint.qos.durability == "transient_local"
        with connection.listen(endpoint.data_key, latched=latched) as samples:
            printed = 0
            while count is None or printed < count:
                sample = _next(samples, wait, endpoint.topic)
                try:
                    value = to_plain(
                        codec.decode(message, sample.payload.to_bytes()),
                        None if full or json else _SHOWN,
                    )
                except InvalidMessage as error:
                    value = {"invalid": str(error)}
                printed += 1
                if json:
                    line(json_module.dumps(value))
                else:
                    line(yaml.safe_dump(value, sort_keys=False, default_flow_style=None) + "---")


@app.command()
def hz(
    topic: Topic,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: Robot = "",
    seconds: Annotated[float, typer.Option(min=0.5, help="How long to measure [s].")] = 5.0,
    json: Json = False,
) -> None:
    """Measure a topic's rate, jitter, size and losses from the raw messages."""
    with connected(connect, domain) as connection:
        endpoint = _endpoint(connection, topic, robot)
        arrivals: list[float] = []
        sizes: list[int] = []
        last: dict[bytes, int] = {}
        lost = 0
        with connection.listen(endpoint.data_key) as samples:
            end = time.monotonic() + seconds
            while (left := end - time.monotonic()) > 0:
                try:
                    sample = samples.get(timeout=left)
                except queue.Empty:
                    break
                arrivals.append(time.monotonic())
                sizes.append(len(sample.payload))
                sent = attachment_of(sample)
                if sent is not None:
                    lost += max(0, sent.sequence - last.get(sent.gid, sent.sequence - 1) - 1)
                    last[sent.gid] = sent.sequence
    if not arrivals:
        raise CairnError(f"no message on {endpoint.topic} within {seconds:g} s")
    gaps = [after - before for before, after in itertools.pairwise(arrivals)]
    mean = statistics.fmean(gaps) if gaps else 0.0
    result = {
        "topic": endpoint.topic,
        "messages": len(arrivals),
        "hz": round(1 / mean, 3) if mean > 0 else 0.0,
        "period_ms": round(mean * 1e3, 3),
        "jitter_ms": round(statistics.pstdev(gaps) * 1e3, 3) if gaps else 0.0,
        "longest_ms": round(max(gaps, default=0.0) * 1e3, 3),
        "bytes": round(statistics.fmean(sizes)) if sizes else 0,
        "lost": lost,
    }
    if json:
        print_json(result)
    else:
        titles = {key: key.replace("_", " ") for key in result}
        show([result], titles, as_json=False)


def _endpoint(connection: Connection, topic: str, robot: str) -> keys.EndpointEntity:
    endpoints = [end for end in connection.endpoints() if end.kind in ("MP", "MS")]
    full = resolve(sorted({end.topic for end in endpoints}), topic, robot)
    ends = [end for end in endpoints if end.topic == full]
    types = sorted({end.type_name for end in ends})
    if len(types) > 1:
        raise CairnError(f"{full} is used with several message types: {', '.join(types)}")
    writers = [end for end in ends if end.kind == "MP"]
    return (writers or ends)[0]


def _next(samples: "queue.Queue[Any]", wait_s: float, topic: str) -> Any:
    try:
        return samples.get(timeout=wait_s)
    except queue.Empty:
        raise CairnError(f"{topic}: no message within {wait_s:g} s") from None
