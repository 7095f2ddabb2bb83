"""A robot on two machines: the way of a topic between them, and a tour with a cable that is cut.

Needs root and network namespaces. The round trip goes over a pair of virtual Ethernet devices; the
tour over a relay that can be cut.
"""

import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import yaml

from cairn.deployment.shipped import FOLDER
from cairn.security.authority import Authority, AuthorityMember
from cairn.security.folder import VARIABLE, RobotFolder
from cairn_lab.benchmarks.result import Metric
from cairn_lab.benchmarks.running import results, run_deployment
from cairn_lab.evaluation.runs import Trial, examination, robot_start, survey
from tests.machines.network import Computer, missing, two_computers, wired_computers

ROUNDS = 3
COUNT = 2000
GOALS = 10
CUTS = 10
CUT_S = 5.0
_PAUSE_S = 8.0  # between two cuts
_LIMIT_S = 900.0
_ROUND_TRIPS = """
components:
  pong: {plugin: "cairn_lab.benchmarks.roundtrip:ScanPong", machine: second}
  ping:
    plugin: "cairn_lab.benchmarks.roundtrip:ScanPing"
    parameters: {payload: "2.8 kB scan", count: %d}
    restart: transient
    significant: true
"""


def measure() -> list[Metric]:
    """Measure the round trips and the tour; nothing if this computer has no network namespaces."""
    if reason := missing():
        print(f"machines: not measured: {reason}")
        return []
    return [*_round_trips(), *_tour()]


def _round_trips() -> Iterator[Metric]:
    """Compare a topic of Cairn with Zenoh's own routers and peers over the same devices."""
    with wired_computers() as (first, second), _identities(first, second) as security:
        found: dict[str, list[float]] = {"cairn": [], "local": [], "tls": [], "tcp": []}
        for _ in range(ROUNDS):  # in turn: the computer may be busier at one time than at another
            found["cairn"].append(_cairn_round_trip(first, second))
            found["local"].append(_local_round_trip())
            for kind in ("tls", "tcp"):
                found[kind].append(_raw_round_trip(kind, first, second, security))
    cairn, local, tls, tcp = (statistics.median(one) for one in found.values())
    us = [f"{1e6 * one:.0f} us" for one in (cairn, local, tls, tcp)]
    note = f"{us[0]}, on one machine {us[1]}; raw {us[2]} with TLS, {us[3]} with TCP"
    added = (cairn - local) / tls
    yield Metric("2.8 kB scan: what the machines add / raw Zenoh by TLS", added, "", 1.5, note=note)
    yield Metric("2.8 kB scan between machines / raw Zenoh by TLS", cairn / tls, "")
    yield Metric("raw Zenoh by mutual TLS / by TCP", tls / tcp, "", 1.15)


def _tour() -> Iterator[Metric]:
    """Drive to random goals in the office with a remote localizer and recognizer."""
    world = FOLDER / "worlds" / "office.yaml"
    with two_computers() as (first, second, cable), _identities(first, second), _folder() as folder:
        map_file = folder / "office.yaml"
        survey(world, map_file, map_file.with_suffix(".cairn"))
        trial = Trial(
            deployment=FOLDER / "sim.yaml",
            world=world,
            map_file=map_file,
            visual_map=map_file.with_suffix(".cairn"),
            start=robot_start(world),
            goals=GOALS,
            kidnap_at=0,
            sets=(),
        )
        examined = examination(trial, folder).model_dump(mode="json", exclude_defaults=True)
        examined["machines"] = {
            "first": {"address": first.address},
            "second": {"address": second.address},
        }
        components = examined["components"]
        components["vision_supervisor"]["machine"] = "second"
        automove = components["mobile_supervisor"]["children"]["automove"]
        automove["children"]["localizer"]["machine"] = "second"
        result = Path(components["examiner"]["parameters"]["file"])
        file = folder / "tour.yaml"
        file.write_text(json.dumps(examined), encoding="utf-8")
        cuts = 0
        with _two_runs(first, second, folder, str(file)) as runs:
            began = time.monotonic()
            while runs[0].poll() is None and time.monotonic() - began < _LIMIT_S:
                time.sleep(_PAUSE_S)
                if cuts < CUTS and runs[0].poll() is None and not result.exists():
                    cuts += 1
                    cable.is_cut = True
                    time.sleep(CUT_S)
                    cable.is_cut = False
        tour = json.loads(result.read_text(encoding="utf-8"))
    reached = sum(goal["reached"] for goal in tour["goals"])
    yield Metric("goals reached on the tour", reached, f"of {GOALS}", at_least=GOALS)
    yield Metric("collisions", len(tour["collisions"]), "", 0)
    yield Metric(f"cuts of {CUT_S:g} s meanwhile", cuts, "", at_least=CUTS)


def _machines(first: Computer, second: Computer) -> str:
    addresses = f"first: {{address: {first.address}}}, second: {{address: {second.address}}}"
    return f"machines: {{{addresses}}}\n"


@contextmanager
def _folder() -> Iterator[Path]:
    with TemporaryDirectory() as folder:
        yield Path(folder)


@contextmanager
def _identities(first: Computer, second: Computer) -> Iterator[Path]:
    """Make the identities of the two machines of robot `robot`; yield its folder."""
    with _folder() as folder:
        os.environ[VARIABLE] = str(folder / "security")
        members = [
            AuthorityMember("first", None, (first.address,)),
            AuthorityMember("second", None, (second.address,)),
        ]
        robot = RobotFolder.of("robot")
        Authority.create(robot, members)
        yield robot.path


@contextmanager
def _two_runs(
    first: Computer, second: Computer, folder: Path, *arguments: str
) -> Iterator[list["subprocess.Popen[str]"]]:
    runs = []
    try:
        for name, computer in (("first", first), ("second", second)):
            sockets = folder / f"bus-{name}"
            sockets.mkdir(mode=0o700)
            command = [sys.executable, "-m", "cairn.cli.program", "up", *arguments]
            command += ["--machine", name, "--report", str(folder / name)]
            command += ["--set", f"bus.socket={sockets}/bus.sock"]
            run = subprocess.Popen(
                command,
                stdout=(folder / f"{name}.log").open("w"),
                stderr=subprocess.STDOUT,
                preexec_fn=computer.enter,
                text=True,
            )
            runs.append(run)
        yield runs
    finally:
        for run in runs:
            run.terminate()
        for run in runs:
            run.wait(60)


def _cairn_round_trip(first: Computer, second: Computer) -> float:
    """Return the median round trip [s] of a component's scan to the other machine and back."""
    with _folder() as folder:
        file = folder / "bench.yaml"
        text = "cairn: 1\nrobot: robot\n" + _machines(first, second) + _ROUND_TRIPS % COUNT
        file.write_text(text)
        with _two_runs(first, second, folder, str(file)) as runs:
            if runs[0].wait(_LIMIT_S):
                raise RuntimeError((folder / "first.log").read_text())
        return float(results((folder / "first.log").read_text())[0]["median"]) / 1e6


def _local_round_trip() -> float:
    """Return the median round trip [s] of a component's scan on one machine."""
    text = _ROUND_TRIPS.replace(", machine: second", "") % COUNT
    components = yaml.safe_load(text)["components"]
    return float(results(run_deployment(components, _LIMIT_S))[0]["median"]) / 1e6


def _raw_round_trip(kind: str, first: Computer, second: Computer, security: Path) -> float:
    """Return the median round trip [s] between raw peers, each at a router of its own."""
    with _folder() as folder:
        runs = [
            subprocess.Popen(
                [
                    sys.executable,
                    "-c",
                    _RAW,
                    kind,
                    name,
                    second.address,
                    str(security),
                    str(folder),
                ],
                stdout=subprocess.PIPE,
                stdin=subprocess.PIPE,
                preexec_fn=computer.enter,
                text=True,
            )
            for name, computer in (("second", second), ("first", first))
        ]
        assert runs[1].stdout is not None
        median = float(runs[1].stdout.readline())
        for run in runs:
            run.communicate("end\n", timeout=60)
        return median


_RAW = f"""
import json, statistics, sys, time, zenoh
from pathlib import Path
kind, name, address, security, folder = sys.argv[1:]
endpoint = f"{{kind}}/{{address}}:7448"
unix = f"unixsock-stream/{{folder}}/{{name}}"

def opened(mode, listen, connect):
    config = zenoh.Config()
    own = f"{{security}}/identities/{{name}}"
    settings = {{
        "mode": mode, "listen/endpoints": listen, "connect/endpoints": connect,
        "connect/exit_on_failure": False, "scouting/multicast/enabled": False,
        "transport/link/tls": {{
            "root_ca_certificate": f"{{security}}/ca.pem", "enable_mtls": True,
            "listen_certificate": own + ".pem", "listen_private_key": own + ".key",
            "connect_certificate": own + ".pem", "connect_private_key": own + ".key",
        }},
    }}
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)

remote = [endpoint]
router = opened("router", [unix + "-router", *(remote if name == "second" else [])],
                remote if name == "first" else [])
peer = opened("peer", [unix + "-peer"], [unix + "-router"])
options = dict(congestion_control=zenoh.CongestionControl.DROP,
               priority=zenoh.Priority.INTERACTIVE_HIGH)
publisher = peer.declare_publisher("pong" if name == "second" else "ping", **options)
if name == "second":
    subscriber = peer.declare_subscriber("ping", lambda sample: publisher.put(sample.payload))
else:
    subscriber = peer.declare_subscriber("pong", zenoh.handlers.RingChannel(10))
    body, times = b"x" * 2800, []
    while not publisher.matching_status.matching:
        time.sleep(0.05)
    time.sleep(0.5)
    while len(times) < {COUNT}:
        began = time.perf_counter()
        publisher.put(body)
        subscriber.handler.recv()
        times.append(time.perf_counter() - began)
    print(statistics.median(times[{COUNT} // 10:]), flush=True)
sys.stdin.readline()
peer.close()
router.close()
"""
