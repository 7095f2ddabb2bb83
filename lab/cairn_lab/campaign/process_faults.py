"""Faults of processes and of their disk: kill, stop, hold inactive, no space, commands."""

from __future__ import annotations

import resource
import shlex
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from random import Random
from typing import Annotated, Any

import psutil
from pydantic import Field

from cairn.bus.control import ControlError, NoReplyError
from cairn.errors import CairnError
from cairn.runtime.parameters import Config
from cairn_lab.campaign.fault import Fault, Injection, SkippedFault
from cairn_lab.campaign.parameters import Duration, Targets, TargetsForTime, matching
from cairn_lab.campaign.robot import CampaignRobot

_REQUEST_S = 5.0
_UNDO_TRIES = 6
_COMMAND_S = 10.0


class Kill(Fault):
    """Kill the process of a component (SIGKILL)."""

    config_type = Targets
    config: Targets

    @contextmanager
    def inject(self, robot: CampaignRobot, random: Random) -> Iterator[Injection]:
        """Kill it; its supervisor restarts it."""
        name = drawn(robot, self.config, random)
        process = robot.process(name)
        with running(name):
            process.kill()
        yield Injection(name, f"killed process {process.pid}")


class KillRoot(Fault):
    """Kill the root of a machine (`cairn up`) or its zygote: all processes there end."""

    config_type = Config
    ends_deployment = True

    @contextmanager
    def inject(self, robot: CampaignRobot, random: Random) -> Iterator[Injection]:
        """Kill one of the two."""
        name = random.choice([*robot.roots.values(), *robot.zygotes.values()])
        process = robot.process(name)
        with running(name):
            process.kill()
        yield Injection(name, f"killed process {process.pid}")


class Stop(Fault):
    """Stop the process of a component (SIGSTOP), and continue it later."""

    config_type = TargetsForTime
    config: TargetsForTime

    @contextmanager
    def inject(self, robot: CampaignRobot, random: Random) -> Iterator[Injection]:
        """Stop it; if that lasts too long, its supervisor kills and restarts it."""
        name = drawn(robot, self.config, random)
        lasts_s = self.config.draw(random)
        process = robot.process(name)
        with running(name):
            if process.status() == psutil.STATUS_STOPPED:
                raise SkippedFault(f"{name} is stopped already")
            process.suspend()
        try:
            yield Injection(name, f"stopped process {process.pid} for {lasts_s:g} s", lasts_s)
        finally:
            with suppress(psutil.NoSuchProcess):  # its supervisor has killed it
                process.resume()


class Hold(Fault):
    """Hold a component inactive, as if its device were missing, and activate it later."""

    config_type = TargetsForTime
    config: TargetsForTime

    @contextmanager
    def inject(self, robot: CampaignRobot, random: Random) -> Iterator[Injection]:
        """Request it of the component's supervisor."""
        name = drawn(robot, self.config, random)
        lasts_s = self.config.draw(random)
        try:
            self._request(robot, name, "inactive")
        except CairnError as error:
            # It may hold it nevertheless, when it answers late.
            self._release(robot, name)
            raise SkippedFault(f"{name} cannot be held inactive: {error}") from error
        try:
            yield Injection(name, f"held inactive for {lasts_s:g} s", lasts_s)
        finally:
            self._release(robot, name)

    def _release(self, robot: CampaignRobot, name: str) -> None:
        """Have it activated; a supervisor that was restarted meanwhile holds nothing."""
        for _ in range(_UNDO_TRIES):
            if robot.has_ended():
                return
            with suppress(NoReplyError):
                with suppress(ControlError):  # it is being restarted, which makes it active
                    self._request(robot, name, "active")
                return

    def _request(self, robot: CampaignRobot, name: str, state: str) -> None:
        arguments = {"name": name, "state": state}
        robot.request(robot.supervisor_of(name), "hold", arguments, _REQUEST_S)


class DiskFull(Fault):
    """Let no file of a machine grow, as on a full disk (RLIMIT_FSIZE of all processes)."""

    config_type = Duration
    config: Duration

    @contextmanager
    def inject(self, robot: CampaignRobot, random: Random) -> Iterator[Injection]:
        """Limit the files of all processes, and of those that they start meanwhile, to 0 bytes."""
        lasts_s = self.config.draw(random)
        machine = random.choice(robot.machines)
        count = _limit_files(robot, machine, 0)
        if not count:
            raise SkippedFault("the disk is full already")
        effect = f"no file of {count} processes grows for {lasts_s:g} s"
        try:
            yield Injection(robot.roots[machine], effect, lasts_s)
        finally:
            # The limit that all of them have inherited from this process.
            before, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
            while _limit_files(robot, machine, before):
                pass  # what was forked meanwhile has inherited the other limit


class SetParametersConfig(Duration):
    """Parameters of `set_parameters`."""

    component: str = Field(min_length=1, max_length=200, description="Name of the component.")
    values: dict[str, Any] = Field(min_length=1, description="Its parameters, by dotted name.")


class SetParameters(Fault):
    """Change parameters of a component, and change them back later.

    For components that misbehave on demand, such as a scanner that is simulated with failures.
    """

    config_type = SetParametersConfig
    config: SetParametersConfig

    @contextmanager
    def inject(self, robot: CampaignRobot, random: Random) -> Iterator[Injection]:
        """Set them; a component that is restarted has those of the deployment again."""
        name, values = self.config.component, self.config.values
        lasts_s = self.config.draw(random)
        try:
            rows = robot.request(name, "parameters", {}, _REQUEST_S)
            before = {row["name"]: row["value"] for row in rows if row["name"] in values}
            robot.request(name, "set_parameters", values, _REQUEST_S)
        except CairnError as error:
            raise SkippedFault(f"the parameters of {name} cannot be changed: {error}") from error
        shown = ", ".join(f"{key} = {value}" for key, value in values.items())
        try:
            yield Injection(name, f"set {shown} for {lasts_s:g} s", lasts_s)
        finally:
            if not robot.has_ended():
                with suppress(NoReplyError):  # it hangs: its supervisor restarts it
                    robot.request(name, "set_parameters", before, _REQUEST_S)


class FaultCommandConfig(Config):
    """Parameters of `fault_command`."""

    program: str = Field(min_length=1, description="One of the campaign's `programs`.")
    lines: tuple[Annotated[str, Field(min_length=1, max_length=1000)], ...] = Field(
        min_length=1, description="Fault commands, of which one is drawn, such as `unplug 2`."
    )


class FaultCommand(Fault):
    """Give a program of the campaign, such as an emulator, a fault command on its stdin."""

    config_type = FaultCommandConfig
    config: FaultCommandConfig

    @contextmanager
    def inject(self, robot: CampaignRobot, random: Random) -> Iterator[Injection]:
        """Write one line; the program ends the fault by itself."""
        text = random.choice(self.config.lines)
        try:
            robot.programs.write(self.config.program, text)
        except CairnError as error:
            raise SkippedFault(str(error)) from error
        yield Injection(self.config.program, f"command {text!r}")


class CommandConfig(Duration):
    """Parameters of `command`."""

    target: str = Field(min_length=1, max_length=200, description="What it disturbs, in words.")
    begin: tuple[str, ...] = Field(
        min_length=1, description="Program and arguments that inject the fault."
    )
    undo: tuple[str, ...] = Field(
        min_length=1, description="Program and arguments that undo it; also run if `begin` failed."
    )


class Command(Fault):
    """Run a command that injects a fault, and later one that undoes it.

    For what only the computer's own tools can do: delays of a network (`tc ... netem`), a port of
    a USB hub without power, steps of the clock.
    """

    config_type = CommandConfig
    config: CommandConfig

    @contextmanager
    def inject(self, robot: CampaignRobot, random: Random) -> Iterator[Injection]:  # noqa: ARG002
        """Run `begin`, and at the end `undo`."""
        lasts_s = self.config.draw(random)
        try:
            _run(self.config.begin)
        except SkippedFault:
            with suppress(SkippedFault):  # the first error is the cause
                _run(self.config.undo)
            raise
        try:
            yield Injection(self.config.target, shlex.join(self.config.begin), lasts_s)
        finally:
            _run(self.config.undo)


def drawn(robot: CampaignRobot, targets: Targets, random: Random) -> str:
    """Return the name of a component; raises `SkippedFault` if none matches."""
    names = matching(robot.components, targets.components, targets.exclude)
    if not names:
        raise SkippedFault(f"no component matches {', '.join(targets.components)}")
    return random.choice(names)


@contextmanager
def running(name: str) -> Iterator[None]:
    """Skip the fault if the process has ended meanwhile."""
    try:
        yield
    except psutil.NoSuchProcess as error:
        raise SkippedFault(f"{name} has just ended") from error


def _limit_files(robot: CampaignRobot, machine: str, size: int) -> int:
    """Limit each file of a machine's processes to `size` [bytes]; return how many had another."""
    if robot.has_ended():
        return 0
    changed = 0
    # The root and the zygote first, so that what they fork next inherits the limit.
    for process in sorted(robot.runs[machine].processes(), key=lambda one: one.create_time()):
        with suppress(psutil.NoSuchProcess, psutil.AccessDenied):  # a helper with setuid
            soft, hard = process.rlimit(psutil.RLIMIT_FSIZE)
            if soft != size:
                process.rlimit(psutil.RLIMIT_FSIZE, (size, hard))
                changed += 1
    return changed


def _run(words: tuple[str, ...]) -> None:
    try:
        ended = subprocess.run(
            words, timeout=_COMMAND_S, check=False, capture_output=True, text=True
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise SkippedFault(f"{' '.join(words)}: {error}") from error
    if ended.returncode:
        printed = (ended.stderr or ended.stdout).strip()[-200:]
        raise SkippedFault(f"{' '.join(words)}: exit status {ended.returncode}: {printed}")
