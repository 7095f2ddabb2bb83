"""Invariants of any deployment: processes, their ends and their use of resources."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from statistics import median

from pydantic import Field

from cairn.deployment.model import Deployment
from cairn.runtime.parameters import Config
from cairn_lab.campaign.growth import growth
from cairn_lab.campaign.invariants import Invariant
from cairn_lab.campaign.observations import DeploymentEnded, LogLine, Processes, ProcessSample

_REASONS = frozenset({"failed", "hung", "stopped", "ended", "start failed", "stop failed"})
"""Events of children with which the log gives the reason for the end of a process."""
_FEWEST_STARTS = 5
_LATE_SAMPLE_S = 10.0
"""How much later than the log a busy computer lets the campaign see the end of a process [s]."""
_QUANTITIES = ("memory", "descriptors", "threads")
_UNITS = {"memory": " MiB", "descriptors": "", "threads": ""}


class OrphanConfig(Config):
    """Parameters of `no_orphan`."""

    patience_s: float = Field(
        15.0, gt=0, le=3600, description="Time after which an orphan counts [s]."
    )


class StaysUp(Invariant):
    """The deployment ends only when the campaign ends it."""

    def on_end(self, end: DeploymentEnded) -> Iterable[str]:
        """Judge an end."""
        if not end.expected:
            last = end.last_lines[-1] if end.last_lines else "nothing"
            yield f"the deployment ended by itself, exit status {end.code}; its last line: {last}"


class NoOrphan(Invariant):
    """Each process of the run has a living owner, and none outlives the deployment."""

    config_type = OrphanConfig
    config: OrphanConfig

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self._since: dict[tuple[int, float, str], float] = {}

    def on_processes(self, at_s: float, processes: Processes) -> Iterable[str]:
        """Judge a sample: a wrong process counts once it was wrong for longer than the patience."""
        wrong = {}
        for process in processes.values():
            problem = self._problem(process, processes)
            if problem:
                wrong[process.pid, process.created_s, problem] = process
        self._since = {key: self._since.get(key, at_s) for key in wrong}
        for key, process in wrong.items():
            if at_s - self._since[key] > self.config.patience_s:
                self._since[key] = float("inf")  # reported once
                yield f"process {process.pid} ({process.name}) {key[2]}"

    def on_start(self, at_s: float, deployment: Deployment) -> Iterable[str]:
        """Forget the launch before."""
        self._since.clear()
        return ()

    def on_end(self, end: DeploymentEnded) -> Iterable[str]:
        """Judge what is left."""
        for left in end.left:
            yield f"process {left} outlived the deployment"

    @staticmethod
    def _problem(process: ProcessSample, processes: Processes) -> str:
        if process.role == "root":
            return ""
        if not process.parent:
            return "has lost its parent, and does not end"
        if process.role == "component":
            twins = [
                one.pid
                for one in processes.values()
                if one.name == process.name and one.created_s < process.created_s
            ]
            return f"runs beside {twins[0]}, an earlier one of the same component" if twins else ""
        zygotes = {one.name for one in processes.values() if one.role == "zygote"}
        if process.role == "helper" and process.parent in zygotes:
            return "belongs to no component that runs"
        return ""


class ReasonsConfig(Config):
    """Parameters of `ends_have_reasons`."""

    patience_s: float = Field(
        30.0,
        gt=0,
        le=3600,
        description="Time until the reason must be in the log [s]: longer than a supervisor may "
        "be stopped, or take to stop another child.",
    )


class EndsHaveReasons(Invariant):
    """For each process of a component that ends, the log has the reason."""

    config_type = ReasonsConfig
    config: ReasonsConfig

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self._running: dict[tuple[int, float], str] = {}
        self._ended: list[tuple[float, str, int]] = []
        self._reasons: dict[str, float] = {}
        self._supervisors: dict[str, str | None] = {}

    def on_start(self, at_s: float, deployment: Deployment) -> Iterable[str]:
        """Forget the launch before."""
        self._supervisors = {member.name: member.parent for member in deployment.members()}
        self._running.clear()
        self._ended.clear()
        return ()

    def on_log(self, line: LogLine) -> Iterable[str]:
        """Note the reasons."""
        child = line.child
        if child is not None and child[0] in _REASONS and child[2]:
            self._reasons[child[1]] = line.at_s
        return ()

    def on_processes(self, at_s: float, processes: Processes) -> Iterable[str]:
        """Find the processes that have ended since the last sample; judge the earlier ones."""
        now = {
            (one.pid, one.created_s): one.name
            for one in processes.values()
            if one.role == "component"
        }
        gone = [(at_s, name, key[0]) for key, name in self._running.items() if key not in now]
        self._ended += gone
        self._running = now
        due = [one for one in self._ended if at_s - one[0] > self.config.patience_s]
        self._ended = [one for one in self._ended if one not in due]
        for ended_s, name, pid in due:
            if self._reason_at(name) < ended_s - _LATE_SAMPLE_S:
                yield (
                    f"process {pid} of {name} ended at {ended_s:.0f} s, and the log has no reason"
                )

    def _reason_at(self, name: str) -> float:
        """Return when the log last gave a reason for the end of a component, or of one above it.

        With a supervisor, all components below it end.
        """
        latest = float("-inf")
        above: str | None = name
        while above is not None:
            latest = max(latest, self._reasons.get(above, latest))
            above = self._supervisors.get(above)
        return latest


class GrowthConfig(Config):
    """Parameters of `bounded_growth`."""

    warm_up_s: float = Field(
        300.0, ge=0, le=86_400, description="Age of a process from which it may not grow [s]."
    )
    percent: float = Field(2.0, ge=0, le=1000, description="Largest growth [%].")
    memory_mib: float = Field(
        2.0, ge=0, le=10_000, description="Growth of memory that does not count [MiB]."
    )
    count: int = Field(
        4,
        ge=0,
        le=10_000,
        description="Growth of descriptors or threads that does not count: their number varies "
        "with the other processes that run at the time.",
    )
    restarted_age_s: float = Field(
        30.0,
        ge=1,
        le=86_400,
        description="Age at which restarted processes of a component are compared with each "
        "other [s].",
    )


@dataclass
class _Life:
    """The samples of one process by quantity: age [s] and value."""

    name: str
    started_s: float
    last_s: float = 0.0
    samples: dict[str, list[tuple[float, float]]] = field(
        default_factory=lambda: {quantity: [] for quantity in _QUANTITIES}
    )


class BoundedGrowth(Invariant):
    """Memory, descriptors and threads do not grow: neither in a process, nor from start to start.

    A process is compared with itself, by the least that it used in the first two minutes after its
    warm-up and in the last two. Processes of a component that are restarted are compared at the
    same age: those of the first third of the campaign with those of the last.
    """

    config_type = GrowthConfig
    config: GrowthConfig

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self._lives: dict[tuple[int, float], _Life] = {}
        self._done: list[_Life] = []
        self._sampled_s = float("-inf")
        self._began: float | None = None

    def on_processes(self, at_s: float, processes: Processes) -> Iterable[str]:
        """Keep a sample of each component, the root and the zygote, every 5 s."""
        self._began = at_s if self._began is None else self._began
        if at_s - self._sampled_s < 5.0:
            return ()
        self._sampled_s = at_s
        alive = set()
        for process in processes.values():
            if process.role == "helper":
                continue
            key = process.pid, process.created_s
            alive.add(key)
            life = self._lives.setdefault(key, _Life(process.name, at_s))
            values = (process.memory_mib, process.descriptors, process.threads)
            for quantity, value in zip(_QUANTITIES, values, strict=True):
                life.samples[quantity].append((at_s - life.started_s, float(value)))
            life.last_s = at_s
        for key in [key for key in self._lives if key not in alive]:
            self._done.append(self._lives.pop(key))
        return ()

    def on_finish(self, at_s: float) -> Iterable[str]:
        """Judge the whole campaign."""
        lives = [*self._done, *self._lives.values()]
        yield from self._within(lives)
        yield from self._from_start_to_start(lives, at_s)

    def _within(self, lives: list[_Life]) -> Iterator[str]:
        for life in lives:
            for quantity, samples in life.samples.items():
                found = growth(samples, self.config.warm_up_s)
                # What lived shorter than twice the warm-up shows no trend.
                age_s = life.last_s - life.started_s
                if found is not None and age_s > 2 * self.config.warm_up_s:
                    problem = self._grown(quantity, *found)
                    if problem:
                        yield f"{life.name}: {problem} in {age_s:.0f} s of one process"

    def _from_start_to_start(self, lives: list[_Life], end_s: float) -> Iterator[str]:
        began, third = self._began or 0.0, (end_s - (self._began or 0.0)) / 3
        by_name: dict[str, list[_Life]] = defaultdict(list)
        for life in lives:
            by_name[life.name].append(life)
        for name, known in sorted(by_name.items()):
            early = [one for one in known if one.started_s < began + third]
            late = [one for one in known if one.started_s >= began + 2 * third]
            for quantity in _QUANTITIES:
                first, last = (self._at_age(some, quantity) for some in (early, late))
                if len(first) >= _FEWEST_STARTS and len(last) >= _FEWEST_STARTS:
                    # The medians: some of the processes have had more to do than others.
                    problem = self._grown(quantity, median(first), median(last))
                    if problem:
                        yield (
                            f"{name}: {problem} from its first {len(first)} to its last "
                            f"{len(last)} processes, {self.config.restarted_age_s:g} s after their "
                            "starts"
                        )

    def _at_age(self, lives: list[_Life], quantity: str) -> list[float]:
        age_s = self.config.restarted_age_s
        found = (
            next((value for age, value in life.samples[quantity] if age >= age_s), None)
            for life in lives
        )
        return [value for value in found if value is not None]

    def _grown(self, quantity: str, first: float, last: float) -> str:
        slack = self.config.memory_mib if quantity == "memory" else self.config.count
        if last - first <= max(slack, first * self.config.percent / 100):
            return ""
        unit = _UNITS[quantity]
        percent = 100 * (last - first) / first if first else 100.0
        return f"{quantity} grew from {first:.1f} to {last:.1f}{unit} ({percent:+.1f} %)"
