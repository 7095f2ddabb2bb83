"""Campaigns in tests: what the pytest fixture `campaign` is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from cairn.testing.launching import Launching
from cairn_lab.campaign.invariants import Invariant
from cairn_lab.campaign.model import parse_campaign
from cairn_lab.campaign.report import CampaignReport
from cairn_lab.campaign.runner import run_campaign

_DEFAULTS: Final[Mapping[str, Any]] = {"count": 10, "interval_s": 1.0, "settle_s": 2.0}


class CampaignRuns:
    """Runs campaigns below a folder, when called."""

    def __init__(self, folder: Path) -> None:
        """`folder` gets the reports: `campaign0`, `campaign1` and so on."""
        self._folder = folder
        self._number = 0

    def __call__(
        self,
        deployment: str | Path,
        faults: Sequence[str | Mapping[str, Any]],
        invariants: Sequence[str | Mapping[str, Any] | Invariant] = (),
        *,
        stop_on_violation: bool = False,
        **keys: Any,
    ) -> CampaignReport:
        """Run a campaign and return its report; `pytest -s` shows its faults.

        Raises `CairnError` if a key is wrong, or the deployment does not start.
        """
        if isinstance(deployment, str) and "\n" in deployment:
            deployment = Launching(self._folder).write(deployment)
        content = {
            **({} if "duration_s" in keys else _DEFAULTS),
            **keys,
            "cairn_campaign": 1,
            "deployment": str(deployment),
            "faults": [_entry(one) for one in faults],
            "invariants": [_entry(one) for one in invariants if not isinstance(one, Invariant)],
        }
        report = self._folder / f"campaign{self._number}"
        self._number += 1
        return run_campaign(
            parse_campaign(content, "campaign"),
            Path.cwd(),
            report,
            show=print,
            stop_on_violation=stop_on_violation,
            invariants=[one for one in invariants if isinstance(one, Invariant)],
        )


def _entry(one: str | Mapping[str, Any]) -> dict[str, Any]:
    return {"kind": one} if isinstance(one, str) else dict(one)
