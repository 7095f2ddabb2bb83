"""What each process of a campaign used: the largest values, memory over time, a plot."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

from cairn_lab.campaign.observations import Processes

PLOT_NAME = "memory.png"
_PERIOD_S = 5.0


@dataclass
class ProcessUse:
    """What the processes of one name used: how many there were, and the largest values.

    `first_mib` and `last_mib` are the medians of the memory of all in the first and the last sixth
    of the campaign; 0 if it was too short. Memory is anonymous memory.
    """

    starts: int = 0
    memory_mib: float = 0.0
    descriptors: int = 0
    threads: int = 0
    first_mib: float = 0.0
    last_mib: float = 0.0


@dataclass
class Resources:
    """Collects samples of components, root and zygote."""

    uses: dict[str, ProcessUse] = field(default_factory=dict)
    _memory: dict[str, list[tuple[float, float]]] = field(default_factory=lambda: defaultdict(list))
    _known: set[tuple[str, int, float]] = field(default_factory=set)
    _kept_s: float = float("-inf")

    def add(self, at_s: float, processes: Processes) -> None:
        """Add a sample of all processes, at a time [s] since the campaign began."""
        is_kept = at_s - self._kept_s >= _PERIOD_S
        self._kept_s = at_s if is_kept else self._kept_s
        for process in processes.values():
            if process.role == "helper":
                continue
            use = self.uses.setdefault(process.name, ProcessUse())
            identity = process.name, process.pid, process.created_s
            use.starts += identity not in self._known
            self._known.add(identity)
            use.memory_mib = max(use.memory_mib, round(process.memory_mib, 1))
            use.descriptors = max(use.descriptors, process.descriptors)
            use.threads = max(use.threads, process.threads)
            if is_kept:
                self._memory[process.name].append((at_s, process.memory_mib))

    def summarize(self) -> dict[str, ProcessUse]:
        """Return the uses by name, with the first and the last memory."""
        for name, use in self.uses.items():
            values = [value for _, value in self._memory[name]]
            if size := len(values) // 6:
                use.first_mib = round(median(values[:size]), 1)
                use.last_mib = round(median(values[-size:]), 1)
        return dict(sorted(self.uses.items()))

    def plot(self, folder: Path) -> None:
        """Write the memory over time as a picture into a folder."""
        draw_memory(self._memory, folder / PLOT_NAME)


def draw_memory(memory: Mapping[str, list[tuple[float, float]]], path: Path) -> None:
    """Draw the memory [MiB] of each process over the time [min]."""
    from matplotlib import colormaps  # takes half a second
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 6), layout="constrained")
    axes = figure.add_subplot()
    axes.set_prop_cycle(color=[colormaps["tab20"](number) for number in range(20)])
    for name, samples in sorted(memory.items()):
        times = [at_s / 60 for at_s, _ in samples]
        axes.plot(times, [value for _, value in samples], label=name, linewidth=0.8)
    axes.set_xlabel("time [min]")
    axes.set_ylabel("anonymous memory [MiB]")
    axes.set_ylim(bottom=0)
    if memory:
        axes.legend(fontsize="x-small", ncols=2)
    figure.savefig(path, dpi=100)
