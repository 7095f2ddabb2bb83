"""In words: what a wrong map does to the pose, and whether a repaired one undoes it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from cairn.tools.experiments import text
from cairn.tools.experiments.conditions import (
    AFTER,
    NEAR,
    PHASES,
    QUANTITIES,
    REPAIRED,
    Condition,
    Figure,
)
from cairn.tools.experiments.statistics import LEAST_CASES, Mean

Figures = Mapping[tuple[str, str, str], Figure]
"""By condition, phase and quantity."""
_NEAR = f"{100 * NEAR:g} %"


def repair(found: Figures, kept: Condition, fixed: Condition, ways: int) -> Iterator[str]:
    """Of one filter in the changed room: with a map that is `kept` up, and with one that is not."""
    wrong = {q: found[fixed.name, AFTER, q].against_unchanged for q in QUANTITIES}
    yield _harm(wrong)
    left = {q: found[kept.name, REPAIRED, q].against_unchanged for q in QUANTITIES}
    repaired = max(ratio.runs for ratio in left.values())
    if not repaired:
        yield (
            f"In none of {text.count(ways, 'way')} the moved object was registered anew: what a "
            "repaired map leaves of that cannot be told."
        )
        return
    if repaired < ways:
        yield (
            f"In {ways - repaired} of {text.count(ways, 'way')} the moved object was not "
            "registered anew: what follows leaves them out."
        )
    yield ""
    yield from text.table(
        (
            f"against unchanged, {PHASES[REPAIRED]}",
            fixed.title,
            kept.title,
            f"kept up: within {_NEAR}",
            "ways in which it is",
        ),
        [
            (
                title,
                text.change(found[fixed.name, REPAIRED, q].against_unchanged),
                text.change(left[q]),
                _verdict(left[q]),
                text.count_of_cases(found[kept.name, REPAIRED, q].ways_near_unchanged),
            )
            for q, title in QUANTITIES.items()
        ],
    )
    yield ""
    yield from _undone(left, repaired)


def _harm(wrong: Mapping[str, Mean]) -> str:
    """What a map does that is not kept up, as far as the intervals can tell."""
    begin = "With a map that is not kept up, after the change"
    fewest = min(ratio.runs for ratio in wrong.values())
    if fewest < LEAST_CASES:
        return f"{begin}: {_listed(wrong)}; {_too_few(fewest)} whether that is chance."
    raised = {q: r for q, r in wrong.items() if r.low is not None and r.low > 1}
    lowered = {q: r for q, r in wrong.items() if r.high is not None and r.high < 1}
    rest = [q for q in wrong if q not in raised and q not in lowered]
    parts = []
    if raised:
        parts.append(f"more than in the unchanged room: {_listed(raised)}")
    if lowered:
        parts.append(f"less: {_listed(lowered)}")
    if rest:
        parts.append(f"no difference that the ways can tell: {', '.join(map(_name, rest))}")
    return f"{begin}: {'; '.join(parts)}."


def _undone(left: Mapping[str, Mean], ways: int) -> Iterator[str]:
    """Which quantities are back at those of the unchanged room, which are not, and how sure."""
    back = [q for q, ratio in left.items() if _is_near(ratio.mean)]
    off = {q: ratio for q, ratio in left.items() if q not in back}
    told = f"With a map that is kept up, {len(back)} of {len(left)} are back to within {_NEAR}"
    yield f"{told} of the unchanged room's{f'; not: {_listed(off)}' if off else ''}."
    if ways < LEAST_CASES:
        yield f"{_too_few(ways)} whether it is so in others."
        return
    unsure = [_name(q) for q, ratio in left.items() if _is_unsure(ratio)]
    if unsure:
        yield (
            f"{ways} ways cannot tell for {text.enumerated(unsure)}: the interval reaches across "
            f"{_NEAR}."
        )
    else:
        yield f"{ways} ways can tell: no interval reaches across {_NEAR}."


def _verdict(ratio: Mean) -> str:
    told = "yes" if _is_near(ratio.mean) else "no"
    return f"{told}, not sure" if _is_unsure(ratio) else told


def _is_near(ratio: float | None) -> bool:
    return ratio is not None and abs(ratio - 1) <= NEAR


def _is_unsure(ratio: Mean) -> bool:
    """Whether the interval of a ratio is neither all near nor all off, or there is none."""
    if ratio.low is None or ratio.high is None or ratio.runs < LEAST_CASES:
        return True
    all_near = _is_near(ratio.low) and _is_near(ratio.high)
    all_off = ratio.low > 1 + NEAR or ratio.high < 1 - NEAR
    return not (all_near or all_off)


def _too_few(ways: int) -> str:
    return f"{text.count(ways, 'way')} cannot tell"


def _listed(ratios: Mapping[str, Mean]) -> str:
    return ", ".join(f"{_name(q)} {text.change(ratio)}" for q, ratio in ratios.items())


def _name(quantity: str) -> str:
    return QUANTITIES[quantity].partition(" [")[0]
