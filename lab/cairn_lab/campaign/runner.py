"""Runs a campaign: injects the faults when they are due, observes, and judges the invariants."""

from __future__ import annotations

import math
import queue
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from random import Random

from cairn.errors import CairnError
from cairn.testing.launching import launching
from cairn_lab.campaign.entry_points import instance_of
from cairn_lab.campaign.fault import FAULTS, Fault, Injection
from cairn_lab.campaign.goals import GoalSender
from cairn_lab.campaign.invariants import INVARIANTS, Invariant
from cairn_lab.campaign.model import Campaign
from cairn_lab.campaign.network import Network
from cairn_lab.campaign.observations import GoalEnded, LogLine
from cairn_lab.campaign.plan import PlannedFault, planned_faults
from cairn_lab.campaign.programs import Programs
from cairn_lab.campaign.recordings import LaunchRecording, attachments_of, rerun_command
from cairn_lab.campaign.report import OUTPUT_NAME, CampaignReport, FaultRecord, Violation
from cairn_lab.campaign.resources import Resources
from cairn_lab.campaign.robot import CampaignRobot
from cairn_lab.campaign.stepped_clock import Clocks

_TICK_S = 0.1
_LATE_S = 1.0
_SAMPLE_S = 1.0
_BEFORE_S = 60.0
_MOST_VIOLATIONS = 10_000
_WRITE_S = 60.0
_CAMPAIGN = "campaign"
"""The name for violations that the campaign itself finds."""
_PROBLEMS = ("WARNING", "ERROR", "CRITICAL")

_Call = Callable[[Invariant], Iterable[str]]


@dataclass
class _Active:
    """A fault that is to be undone at a time [s]."""

    until_s: float
    record: FaultRecord
    injection: Injection
    context: AbstractContextManager[Injection]


def run_campaign(
    campaign: Campaign,
    folder: Path,
    report_folder: Path,
    *,
    name: str = "campaign",
    show: Callable[[str], None] = lambda _: None,
    is_interrupted: Callable[[], bool] = lambda: False,
    stop_on_violation: bool = False,
    invariants: Iterable[Invariant] = (),
) -> CampaignReport:
    """Run a campaign and return its report, which is also written to `report_folder`.

    Args:
        campaign: the campaign.
        folder: where the relative paths in it begin.
        report_folder: a new or empty folder.
        name: of the campaign, for the report.
        show: called with a line for each fault and violation.
        is_interrupted: whether the campaign has to end early.
        stop_on_violation: whether it ends with the first violation.
        invariants: further ones, in addition to those of the campaign.

    Raises:
        CairnError: if the deployment cannot be read or does not start.
    """
    report_folder.mkdir(parents=True, exist_ok=True)
    if any(report_folder.iterdir()):
        raise CairnError(f"{report_folder} is not empty; name another folder for the report")
    read = campaign.read(folder)
    faults = [instance_of(FAULTS, one.kind, one.parameters) for one in campaign.faults]
    with (
        Programs(campaign.programs, report_folder) as programs,
        Network(read.deployment) as network,
        launching(report_folder) as launch,
    ):
        clocked = network.machines if any(one.needs_clocks for one in faults) else ()
        clocks = Clocks(clocked, report_folder)
        robot = CampaignRobot(launch, read, report_folder, programs, network, clocks)
        report = CampaignReport(
            name, campaign.deployment, campaign.seed, report_folder,
            started=f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        )  # fmt: skip
        judges = [
            (one.kind, instance_of(INVARIANTS, one.kind, one.parameters))
            for one in campaign.invariants
        ]
        judges += [(type(one).__name__, one) for one in invariants]
        runner = _Runner(campaign, faults, robot, report, judges, show)
        try:
            runner.run(lambda: is_interrupted() or (stop_on_violation and bool(report.violations)))
        finally:
            runner.close()
            report.write()
    return report


class _Runner:
    """The state of a campaign that runs."""

    def __init__(
        self,
        campaign: Campaign,
        faults: Sequence[Fault],
        robot: CampaignRobot,
        report: CampaignReport,
        judges: list[tuple[str, Invariant]],
        show: Callable[[str], None],
    ) -> None:
        self._campaign = campaign
        self._robot = robot
        self._report = report
        self._judges = judges
        self._show = show
        self._faults = faults
        self._events: queue.Queue[_Call] = queue.Queue()
        self._active: list[_Active] = []
        self._began = time.monotonic()
        self._resources = Resources()
        self._sampled_s = self._written_s = 0.0
        self._ending = False
        self._goals: GoalSender | None = None
        self._recording: LaunchRecording | None = None
        self._attachments: dict[str, bytes] = {}
        self._goal_random = Random(f"goals {campaign.seed}")

    def run(self, is_over: Callable[[], bool]) -> None:
        """Run until the last fault has settled, the time is over, or `is_over`."""
        if self._campaign.recording is not None:
            self._attachments = attachments_of(self._robot)
        self._launch()
        self._began = time.monotonic()
        plan = planned_faults(self._campaign)
        due = next(plan, None)
        end_s = self._end_s(is_last=due is None)
        delay_s = 0.0
        while self._now() < end_s:
            if is_over():
                self._report.interrupted = True
                return
            self._step()
            now = self._now()
            if due is not None and now >= due.at_s + delay_s:
                # What was missed, as while the deployment starts again, does not come at once.
                late_s = now - due.at_s - delay_s
                delay_s += late_s if late_s > _LATE_S else 0.0
                self._inject(due)
                due = next(plan, None)
                end_s = self._end_s(is_last=due is None)

    def close(self) -> None:
        """Undo all faults, stop the deployment, and judge the end."""
        self._ending = True
        self._undo(lambda _: True)
        if self._goals is not None:
            self._goals.close()
            self._goals = None
        self._take_events()
        if not self._robot.has_ended():
            self._judge_processes()
            self._robot.stop()
            self._close_launch(expected=True)
        elif self._robot.is_launched:
            # A deployment that has never started has not ended by itself: an error is raised.
            self._close_launch(expected=self._report.launches == 0)
        now = self._now()
        self._judge(now, lambda one: one.on_finish(now))
        self._report.duration_s = now
        self._report.processes = self._resources.summarize()
        self._resources.plot(self._report.folder)
        commands: dict[str, str] = {}
        for violation in self._report.violations:
            if violation.recording and violation.recording not in commands:
                path = self._report.folder / violation.recording
                commands[violation.recording] = rerun_command(path)
            violation.rerun = commands.get(violation.recording, "")

    def _end_s(self, *, is_last: bool) -> float:
        """Return when the campaign ends: with its duration, or when its last fault has settled."""
        end_s = math.inf if self._campaign.duration_s is None else self._campaign.duration_s
        if is_last and self._campaign.count is not None:
            end_s = min(end_s, self._now() + self._campaign.settle_s)
        return end_s

    def _now(self) -> float:
        return time.monotonic() - self._began

    def _launch(self) -> None:
        self._robot.launch(self._record)
        self._report.launches += 1
        for _, judge in self._judges:
            for topic, message in judge.topics.items():
                self._robot.observe(topic, message, self._receiver(judge))
        now = self._now()
        self._judge(now, lambda one: one.on_start(now, self._robot.deployment))
        self._goals = self._new_goals()

    def _new_goals(self) -> GoalSender | None:
        if self._campaign.goals is None:
            return None
        return GoalSender(
            self._campaign.goals,
            self._goal_random,
            self._robot.endpoint,
            self._robot.deployment.domain,
            self._robot.deployment.robot.name,
            self._on_goal,
        )

    def _record(self) -> None:
        """Record from the first message on, so that each component can be re-run."""
        settings = self._campaign.recording
        if settings is not None:
            path = self._report.folder / "recording.mcap"
            self._recording = LaunchRecording(self._robot, settings, path, self._attachments)

    def _receiver(self, judge: Invariant) -> Callable[[str, object], None]:
        def receive(topic: str, message: object) -> None:
            at_s = self._now()

            def call(one: Invariant) -> Iterable[str]:
                return one.on_message(at_s, topic, message) if one is judge else ()

            self._events.put(call)

        return receive

    def _on_goal(self, goal: GoalEnded) -> None:
        ended = replace(goal, at_s=round(self._now(), 1), took_s=round(goal.took_s, 1))
        self._report.goals.append(ended)
        self._events.put(lambda one: one.on_goal(ended))

    def _step(self) -> None:
        """Wait for a moment, and take what has happened."""
        try:
            call = self._events.get(timeout=_TICK_S)
        except queue.Empty:
            pass
        else:
            self._judge(self._now(), call)
            self._take_events(_TICK_S)
        now = self._now()
        self._take_lines(now)
        if self._goals is not None and self._goals.failure is not None:
            self._violate(_CAMPAIGN, f"sending goals failed: {_place(self._goals.failure)}")
            self._goals = self._new_goals()
        if self._robot.has_ended():
            self._relaunch(expected=False)
            return
        self._undo(lambda one: one.until_s <= now)
        if now - self._sampled_s >= _SAMPLE_S:
            self._sampled_s = now
            self._judge_processes()
        if now - self._written_s >= _WRITE_S:  # so that a kill of the campaign loses little
            self._written_s = now
            self._report.duration_s = now
            self._report.processes = self._resources.summarize()
            self._report.write()

    def _take_events(self, limit_s: float = math.inf) -> None:
        """Judge what has arrived, for a limited time [s] while more may arrive faster."""
        deadline = time.monotonic() + limit_s
        while time.monotonic() < deadline:
            try:
                call = self._events.get_nowait()
            except queue.Empty:
                return
            self._judge(self._now(), call)

    def _take_lines(self, now: float) -> None:
        lines = self._robot.new_lines(now)
        if lines:
            with (self._report.folder / OUTPUT_NAME).open("a", encoding="utf-8") as file:
                file.writelines(f"{line.at_s:9.1f} s  {line}\n" for line in lines)
        for line in lines:
            if line.level in _PROBLEMS and self._report.faults:
                self._report.faults[-1].follow(str(line))
            self._judge_line(line)

    def _judge_line(self, line: LogLine) -> None:
        self._judge(line.at_s, lambda one: one.on_log(line))

    def _judge_processes(self) -> None:
        processes = self._robot.processes()
        now = self._now()
        self._resources.add(now, processes)
        self._judge(now, lambda one: one.on_processes(now, processes))

    def _inject(self, planned: PlannedFault) -> None:
        fault = self._faults[planned.entry]
        now = self._now()
        record = FaultRecord(planned.number, planned.kind, round(now, 1))
        self._report.faults.append(record)
        context = fault.inject(self._robot, Random(planned.seed))
        try:
            injection = context.__enter__()
        except CairnError as error:
            record.skipped = str(error)
            self._show(str(record))
            return
        except Exception as error:  # of a fault of another package, hours after the start
            record.skipped = repr(error)
            self._violate(_CAMPAIGN, f"fault {planned.kind} raised {_place(error)}")
            return
        record.target, record.effect = injection.target, injection.effect
        self._show(str(record))
        self._judge(now, lambda one: one.on_fault(now, planned.kind, injection))
        self._active.append(_Active(now + injection.lasts_s, record, injection, context))
        if fault.ends_deployment:
            self._relaunch(expected=True)

    def _undo(self, is_due: Callable[[_Active], bool]) -> None:
        due = [one for one in self._active if is_due(one)]
        self._active = [one for one in self._active if one not in due]
        # The last one first, as they were injected on top of each other.
        for active in reversed(due):
            try:
                active.context.__exit__(None, None, None)
            except Exception as error:  # the others must be undone, too
                kind = active.record.kind
                self._violate(_CAMPAIGN, f"fault {kind} could not be undone: {_place(error)}")
            active.record.effect = active.injection.effect
            if active.injection.lasts_s:
                active.record.until_s = round(self._now(), 1)
                self._judge_undo(active.record.kind, active.injection)

    def _judge_undo(self, kind: str, injection: Injection) -> None:
        now = self._now()
        self._judge(now, lambda one: one.on_undo(now, kind, injection))

    def _relaunch(self, *, expected: bool) -> None:
        self._close_launch(expected=expected)
        if not self._ending:
            self._launch()

    def _close_launch(self, *, expected: bool) -> None:
        self._undo(lambda _: True)
        if self._goals is not None:
            self._goals.close()
            self._goals = None
        if self._recording is not None:
            self._recording.close()
            self._recording = None
        now = self._now()
        self._robot.await_end()
        self._take_lines(now)
        end = self._robot.close(now, expected=expected)
        self._take_events()
        self._judge(now, lambda one: one.on_end(end))

    def _judge(self, at_s: float, call: _Call) -> None:
        for name, judge in self._judges:
            try:
                found = list(call(judge))
            except Exception as error:  # of an invariant of another package
                found = [f"it raised {_place(error)}"]
            for text in found:
                self._violate(name, text, at_s)

    def _violate(self, invariant: str, text: str, at_s: float | None = None) -> None:
        violations = self._report.violations
        if len(violations) >= _MOST_VIOLATIONS:
            return
        at_s = self._now() if at_s is None else at_s
        recent = [
            one.number
            for one in self._report.injected
            if (one.until_s or one.at_s) >= at_s - _BEFORE_S
        ]
        violation = Violation(len(violations) + 1, invariant, round(at_s, 1), text, recent)
        if self._recording is not None:
            violation.recording = self._recording.keep(f"{invariant}: {text}"[:200])
        violations.append(violation)
        self._show(str(violation))


def _place(error: Exception) -> str:
    """Return an exception with the line of code that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" at {frames[-1].filename}:{frames[-1].lineno}" if frames else ""
    return f"{error!r}{where}"
