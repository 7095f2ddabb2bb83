"""An evaluation in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cairn.tools.evaluation.results import RunResult, Summary


def report_lines(world: str, runs: Sequence[RunResult], summary: Summary) -> Iterator[str]:
    """What went wrong, run by run, then the figures of all runs."""
    for run in runs:
        yield from _what_went_wrong(run)
    yield f"{world}: {summary.runs} runs"
    if summary.failed:
        yield f"  failed            {summary.failed} of {summary.runs} runs"
    yield f"  reached           {summary.reached} of {summary.goals}, {summary.reached_share:.1%}"
    yield from _events(summary)
    if summary.kidnapped:
        yield from _carried_off(summary)
    yield f"  collisions        {summary.collisions}"
    if summary.path_ratio_mean is not None:
        yield (
            f"  way / shortest    {summary.path_ratio_mean:.3f} on average, "
            f"{summary.path_ratio_p95:.3f} at most in 95 %"
        )
    if summary.seconds_mean is not None:
        yield f"  time a goal       {summary.seconds_mean:.1f} s"
    yield f"  recoveries        {summary.recoveries}"
    if summary.end_error_median is not None:
        yield (
            f"  off at the goal   {summary.end_error_median:.3f} m, "
            f"{summary.end_turn_median:.3f} rad median, {summary.end_error_p95:.3f} m, "
            f"{summary.end_turn_p95:.3f} rad in 95 %"
        )
    if summary.error_median is not None:
        yield (
            f"  position error    {summary.error_median:.3f} m median, "
            f"{summary.error_p95:.3f} m in 95 %"
        )
    if summary.within is not None:
        one, two, three = summary.within
        yield f"  truth within      {one:.0%}, {two:.0%}, {three:.0%} in 1, 2, 3 sigma"
    if summary.kidnapped and summary.error_median is not None:
        yield "                    (both but from being carried off until it found itself)"


def _what_went_wrong(run: RunResult) -> Iterator[str]:
    if run.failure:
        yield f"seed {run.seed} failed: {run.failure}"
    for number, goal in enumerate(run.goals, start=1):
        if not goal.reached:
            yield (
                f"seed {run.seed}, goal {number} at ({goal.x:.2f}, {goal.y:.2f}) not reached: "
                f"{goal.reason}"
            )
    for collision in run.collisions:
        yield f"seed {run.seed}, collision: {collision}"


def _events(summary: Summary) -> Iterator[str]:
    """Which events of the world were not tested in every run: they came after its end."""
    runs = summary.runs - summary.failed
    missed = {event: count for event, count in summary.events.items() if count < runs}
    if not missed:
        return
    every = "every run that did not fail" if summary.failed else "every run"
    parts = [f"{len(summary.events) - len(missed)} of {len(summary.events)} came due in {every}"]
    parts += [
        f'"{event}" in {f"{count} of {runs}" if count else "none"}'
        for event, count in missed.items()
    ]
    yield f"  events            {'; '.join(parts)}"


def _carried_off(summary: Summary) -> Iterator[str]:
    yield f"  carried off       arrived {summary.kidnapped_reached} of {summary.kidnapped}"
    found = f"  found itself      {summary.relocalized} of {summary.kidnapped}"
    if summary.relocalized_median_s is not None:
        found += (
            f", in {summary.relocalized_median_s:.1f} s median, "
            f"{summary.relocalized_worst_s:.1f} s at worst"
        )
    yield found
