"""What a deployment says about one component: plugin, parameters, topics, supervision."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
Topic = Annotated[str, Field(pattern=r"^/?[a-zA-Z_][a-zA-Z0-9_]*(/[a-zA-Z_][a-zA-Z0-9_]*)*$")]
Seconds = Annotated[float, Field(gt=0, le=3600, allow_inf_nan=False)]
Restart = Literal["permanent", "transient", "temporary"]
Strategy = Literal["one_for_one", "rest_for_one", "one_for_all"]
LogLevel = Literal["debug", "info", "warning", "error"]
OnLoss = Literal["stop", "degrade", "ignore"]

_KILL_S = 3.0
"""Time [s] allowed for killing a child that did not stop in time."""


class Section(BaseModel):
    """A part of a deployment: strict, frozen, without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, validate_default=True)


class Supervision(Section):
    """What a supervisor does when one of its children dies (Erlang/OTP's semantics)."""

    strategy: Strategy = Field(
        "one_for_one",
        description="What to restart: the child, also those started after it, or all children.",
    )
    max_restarts: int = Field(
        3, ge=0, le=1000, description="Restarts allowed within `within_s`; one more escalates."
    )
    within_s: Seconds = Field(10.0, description="Window in which restarts are counted [s].")


class Storage(Section):
    """Limits on what a deployment writes to the disk."""

    max_log_size: int = Field(
        10_000_000,
        ge=10_000,
        le=10_000_000_000,
        description="A longer log file is renamed to FILE.1, and a new one is started [bytes].",
    )
    old_logs: int = Field(
        2, ge=1, le=100, description="Older log files kept of each process: FILE.1, FILE.2 ..."
    )
    kept_runs: int = Field(
        20,
        ge=1,
        le=10_000,
        description="Run folders kept complete; older ones keep maps and results only.",
    )
    max_runs_size: int = Field(
        10_000_000_000,
        ge=1_000_000,
        le=1_000_000_000_000_000,
        description="Size of all run folders [bytes]; beyond it fewer are kept complete.",
    )


class Fallback(Section):
    """What runs on the parent's machine instead of a component, while its link is slow or down."""

    plugin: str | None = Field(
        None, description="Plugin of the fallback; by default that of the component."
    )
    parameters: dict[str, Any] = Field(
        default_factory=dict,
        description="Parameters in which it differs from the component; all if it has a plugin of "
        "its own.",
    )
    max_round_trip_s: float = Field(
        0.5,
        gt=0,
        le=60,
        allow_inf_nan=False,
        description="The link is slow if there and back takes longer [s].",
    )


class ChildSpec(Section):
    """One component of the tree, as its supervisor starts, watches and restarts it."""

    plugin: str = Field(
        description="Entry point of group cairn.components, or package.module:Class."
    )
    parameters: dict[str, Any] = Field(
        default_factory=dict, description="Values for the plugin's Config."
    )
    topics: dict[str, Topic] = Field(
        default_factory=dict,
        description="Topic of a port, below /<robot>/ unless it begins with /.",
    )
    max_age_s: dict[str, Seconds] = Field(
        default_factory=dict,
        description="Age from which an input is stale, by port [s]; by default that of its class.",
    )
    placement: Literal["process", "in_process"] = Field(
        "process", description="In a process of its own, or in that of its parent."
    )
    interpreter: Literal["shared", "fresh"] = Field(
        "shared", description="Forked from the zygote, or in a Python interpreter of its own."
    )
    restart: Restart = Field(
        "permanent",
        description="Restarted always, only after an abnormal end (transient), or never.",
    )
    significant: bool = Field(False, description="Its normal end ends the deployment.")
    start_timeout_s: Seconds = Field(60.0, description="Limit for becoming active [s].")
    stop_timeout_s: Seconds = Field(
        5.0, description="Limit for stopping [s]; then its process is killed."
    )
    hang_timeout_s: Seconds = Field(
        5.0, description="Limit for one handler [s]; then it counts as hung and is killed."
    )
    memory_max_mib: int = Field(
        1024,
        ge=256,
        le=1 << 20,
        description="Memory of its process [MiB]; with more, it is killed and restarted.",
    )
    log_level: LogLevel | None = Field(
        None, description="Lowest level of what it logs; by default that of the deployment."
    )
    load: Literal["at_start", "on_request"] = Field(
        "at_start", description="Started with its parent, or when its parent or `cairn load` asks."
    )
    supervision: Supervision = Field(
        default_factory=Supervision, description="For its children; supervisors only."
    )
    children: dict[Name, "ChildSpec"] = Field(
        default_factory=dict, description="Its components in start order; supervisors only."
    )
    machine: Name | None = Field(
        None,
        description="Machine that it runs on, with all below it; by default that of its parent.",
    )
    on_loss: OnLoss = Field(
        "degrade",
        description="What its parent does when it runs on another machine that is lost: stop as "
        "after a failure, go on without it, or go on and log nothing.",
    )
    fallback: Fallback | None = Field(
        None,
        description="What runs on its parent's machine instead, while the link to its own is slow "
        "or down.",
    )

    @property
    def ends_supervisor(self) -> bool:
        """Whether its normal end ends its supervisor normally, and so on up to the deployment.

        This includes supervisors with something significant below them: only that can bring about
        their normal end, and they pass it on.
        """
        return self.significant or self._passes_end_on

    @property
    def restart_type(self) -> Restart:
        """When it is restarted: a supervisor that passes a normal end on is not `permanent`."""
        return "transient" if self._passes_end_on and self.restart == "permanent" else self.restart

    @property
    def start_limit_s(self) -> float:
        """The time [s] it may take to become active, with the children that it starts in turn."""
        children = (child for child in self.children.values() if child.load == "at_start")
        return self.start_timeout_s + sum(child.start_limit_s for child in children)

    @property
    def stop_limit_s(self) -> float:
        """The time [s] it may take to stop, with the children that it stops in turn."""
        children = self.children.values()
        return self.stop_timeout_s + sum(child.stop_limit_s + _KILL_S for child in children)

    @property
    def components(self) -> int:
        """The number of components in this part of the tree, this one included."""
        return 1 + sum(child.components for child in self.children.values())

    @property
    def handler_limit_s(self) -> float:
        """The time [s] one handler may take before the component counts as hung.

        A supervisor may be busy with one of its children meanwhile.
        """
        children = self.children.values()
        steps = (max(child.start_limit_s, child.stop_limit_s) for child in children)
        return self.hang_timeout_s + max(steps, default=0.0)

    @property
    def _passes_end_on(self) -> bool:
        return any(child.ends_supervisor for child in self.children.values())
