"""Campaigns: a deployment runs for long, faults are drawn by a seed, invariants are judged.

A package adds kinds of faults by entry points of group `cairn.faults`, and invariants by group
`cairn.invariants`; a campaign may also name them as `package.module:Class`.
"""

from cairn_lab.campaign.fault import Fault, Injection, SkippedFault
from cairn_lab.campaign.invariants import Invariant
from cairn_lab.campaign.model import Campaign, read_campaign
from cairn_lab.campaign.observations import (
    DeploymentEnded,
    GoalEnded,
    LogLine,
    ProcessSample,
)
from cairn_lab.campaign.report import CampaignReport, Violation
from cairn_lab.campaign.robot import CampaignRobot
from cairn_lab.campaign.runner import run_campaign

__all__ = [
    "Campaign",
    "CampaignReport",
    "CampaignRobot",
    "DeploymentEnded",
    "Fault",
    "GoalEnded",
    "Injection",
    "Invariant",
    "LogLine",
    "ProcessSample",
    "SkippedFault",
    "Violation",
    "read_campaign",
    "run_campaign",
]
