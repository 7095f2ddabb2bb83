"""Recorder: what it costs beside a robot with a stereo camera, and what `kill -9` loses.

The robot is `cairn up sim --overlay pixels --record`, for `CAIRN_BENCH_RECORDER_S` seconds (600).
The kills are of processes that record generated messages, at random moments.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from cairn.bus.qos import RELIABLE
from cairn.bus.type_hash import type_hash
from cairn.errors import CairnError
from cairn.recording.mcap_file import McapFile
from cairn.recording.recorder import McapRecorder, RecorderSettings
from cairn.recording.tap import PublisherInfo, Sample
from cairn.schemas.message import schema_messages, type_name
from cairn.schemas.sensor_msgs import Image
from cairn.schemas.std_msgs import String
from cairn.system.clock import SECOND
from cairn_lab.benchmarks.result import Metric

RUN_S = float(os.environ.get("CAIRN_BENCH_RECORDER_S", "600"))
KILLS = 100
_TOGETHER = 4  # processes that are killed at the same time
_START_LIMIT_S = 180.0
_WARM_S = 10.0
_PERIOD_S = 2.0
_KILL_S = (0.0, 2.5)  # range of the time from the start to the kill
_RATE_HZ, _IMAGE_EVERY = 400, 40  # generated messages per second; each so-manieth is an image
_IMAGE_BYTES = 640 * 480 * 3


def measure() -> list[Metric]:
    """Record a robot, then kill recorders."""
    return [*_beside_a_robot(RUN_S), *_killed(KILLS)]


def _beside_a_robot(run_s: float) -> list[Metric]:
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report"
        environment = {**os.environ, "CAIRN_RUNTIME_DIR": f"{folder}/rt"}
        cairn = [sys.executable, "-m", "cairn.cli.program"]
        goals = [[7.5, 3.0, 0.0], [1.0, 1.0, 0.0]] * 100  # it drives all the time
        command = [*cairn, "up", "sim", "--overlay", "pixels", "--record", "--plain"]
        command += ["--report", str(report), "--set", f"mission={json.dumps(goals)}"]
        robot = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL)
        try:
            pid = _await_recorder(cairn, environment)
            time.sleep(_WARM_S)  # while the robot starts
            recorder = psutil.Process(pid)
            began, cpu_s, memory = time.monotonic(), _cpu_s(recorder), []
            while time.monotonic() - began < run_s:
                time.sleep(_PERIOD_S)
                memory.append(recorder.memory_info().rss / 2**20)
            share = (_cpu_s(recorder) - cpu_s) / (time.monotonic() - began)
            status = _asked(cairn, environment, "recorder", "status", "--json")
        finally:
            robot.send_signal(signal.SIGINT)
            robot.wait(60.0)
        with McapFile(report / "recording.mcap") as file:
            missing = _missing(file)
            recorded = sum(file.counts.values())
    note = f"{status['messages']} messages, {status['bytes'] / 1e6:.0f} MB in {run_s:.0f} s"
    half = len(memory) // 2
    return [
        Metric("messages lost or dropped", missing, "", at_most=0, note=note),
        Metric("messages in the file", recorded, "", at_least=status["messages"]),
        Metric("share of a core", 100 * share, "%", at_most=10),
        Metric("memory", max(memory), "MiB", at_most=250),
        Metric(
            "growth of memory in the second half", max(memory) - max(memory[:half]), "MiB",
            at_most=20,
        ),
    ]  # fmt: skip


def _await_recorder(cairn: list[str], environment: dict[str, str]) -> int:
    """Return the process id of the recorder, once it runs."""
    deadline = time.monotonic() + _START_LIMIT_S
    while time.monotonic() < deadline:
        with suppress(RuntimeError):
            for row in _asked(cairn, environment, "ps", "--json"):
                if row["component"].endswith("/recorder") and row["state"] == "active":
                    return int(row["pid"])
        time.sleep(1.0)
    raise RuntimeError(f"no recorder runs within {_START_LIMIT_S:g} s")


def _asked(cairn: list[str], environment: dict[str, str], *words: str) -> Any:
    done = subprocess.run(
        [*cairn, *words], env=environment, capture_output=True, text=True, timeout=60, check=False
    )
    if done.returncode:
        raise RuntimeError(done.stderr)
    return json.loads(done.stdout)


def _cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def _missing(file: McapFile) -> int:
    """Return the gaps in the sequence numbers of all publishers."""
    numbers: dict[tuple[str, str], list[int]] = {}
    for message in file.messages(lambda _: True):
        channel = message.channel
        numbers.setdefault((channel.topic, channel.gid), []).append(message.sequence)
    return sum(max(some) - min(some) + 1 - len(set(some)) for some in numbers.values())


def _killed(kills: int) -> list[Metric]:
    """Kill recorders at random moments, and read what they have written."""
    schema_messages()  # imported here, not in each process
    chance = random.Random(1)
    unreadable, lost_s, gaps = 0, [], 0
    context = multiprocessing.get_context("fork")
    with tempfile.TemporaryDirectory() as folder:
        for begin in range(0, kills, _TOGETHER):
            paths = [Path(folder) / f"{number}.mcap" for number in range(begin, begin + _TOGETHER)]
            processes = [context.Process(target=_record, args=(path,)) for path in paths]
            for process in processes:
                process.start()
            while not all(path.exists() and path.stat().st_size for path in paths):
                time.sleep(0.05)
            started, started_ns = time.monotonic(), time.time_ns()
            order = sorted((chance.uniform(*_KILL_S), index) for index in range(_TOGETHER))
            killed_ns = [0] * _TOGETHER
            for after_s, index in order:
                time.sleep(max(0.0, started + after_s - time.monotonic()))
                killed_ns[index] = time.time_ns()
                processes[index].kill()
            for process, path, at_ns in zip(processes, paths, killed_ns, strict=True):
                process.join()
                try:
                    with McapFile(path) as file:
                        messages = list(file.messages(lambda _: True))
                        gaps += _missing(file)
                except CairnError as error:
                    unreadable += 1
                    print(f"{path.name}: {error}")
                    continue
                last_ns = max((one.log_ns for one in messages), default=started_ns)
                lost_s.append((at_ns - last_ns) / SECOND)
                path.unlink()
    return [
        Metric("files of killed recorders that cannot be read", unreadable, "", at_most=0),
        Metric("missing between the first and the last message", gaps, "", at_most=0),
        Metric("longest time lost by a kill", max(lost_s), "s", at_most=1.0, note=f"{kills} kills"),
    ]


class _KnownPublishers:
    """A tap of the generated messages."""

    lost: Counter[str] = Counter()
    refused = 0

    def publisher(self, gid: bytes) -> PublisherInfo | None:
        return PublisherInfo(f"/robot/{gid.decode().strip()}", RELIABLE)

    def is_present(self, gid: bytes) -> bool:
        return bool(gid)

    def close(self) -> None:
        pass


def _record(path: Path) -> None:
    """Record generated messages until this process is killed."""
    settings = RecorderSettings(keep_free_mb=0)
    recorder = McapRecorder(settings, path, {}, schema_messages().get)
    recorder.start(_KnownPublishers())
    noise = np.random.default_rng(0).integers(0, 60, _IMAGE_BYTES, np.uint8).tobytes()
    sent: Counter[str] = Counter()
    began = time.monotonic()
    while True:
        number = sum(sent.values())
        message, payload = (Image, noise) if number % _IMAGE_EVERY == 0 else (String, b"x" * 300)
        topic = f"/robot/{message.__name__.lower()}"
        sent[topic] += 1
        now = time.time_ns()
        recorder.receive(
            Sample(
                topic, type_name(message), type_hash(message), payload,
                topic.encode()[-16:].rjust(16), sent[topic], now, now,
            )
        )  # fmt: skip
        time.sleep(max(0.0, began + number / _RATE_HZ - time.monotonic()))
