"""Faults of the links between the machines of a deployment: cut, slow, lossy, narrow."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from random import Random

from pydantic import Field

from cairn_lab.campaign.fault import Fault, Injection, SkippedFault
from cairn_lab.campaign.link import Link, LinkConditions
from cairn_lab.campaign.parameters import Duration, Patterns, matching
from cairn_lab.campaign.robot import CampaignRobot


class LinkConfig(Duration):
    """Parameters of `link_cut`."""

    links: Patterns = Field(
        ("*",), description="Links that may be drawn, as patterns of `FIRST-SECOND`, two machines."
    )


class LinkDelayConfig(LinkConfig):
    """Parameters of `link_delay`."""

    latency_s: float = Field(0.1, ge=0, le=60, description="Latency of each direction [s].")
    jitter_s: float = Field(0.05, ge=0, le=60, description="Largest addition to it, drawn [s].")
    loss: float = Field(
        0.0,
        ge=0,
        lt=1,
        description="Share of the pieces that TCP has to send again, 0.2 s later: all that follow "
        "wait [1].",
    )
    bandwidth: float | None = Field(
        None, gt=0, description="Limit of each direction [bytes/s]; null: none."
    )


class LinkCut(Fault):
    """Cut the link between two machines, and restore it later."""

    config_type = LinkConfig
    config: LinkConfig

    @contextmanager
    def inject(self, robot: CampaignRobot, random: Random) -> Iterator[Injection]:
        """Pass on nothing; the connections stay open, as with a cable that is pulled out."""
        lasts_s = self.config.draw(random)
        link = _drawn(robot, self.config, random)
        with link.disturbed(LinkConditions(is_cut=True)):
            yield Injection(link.name, f"cut for {lasts_s:g} s", lasts_s)


class LinkDelay(Fault):
    """Slow down the link between two machines, and restore it later."""

    config_type = LinkDelayConfig
    config: LinkDelayConfig

    @contextmanager
    def inject(self, robot: CampaignRobot, random: Random) -> Iterator[Injection]:
        """Delay all that is sent, stall a share of it, limit the rate."""
        config, lasts_s = self.config, self.config.draw(random)
        link = _drawn(robot, config, random)
        conditions = LinkConditions(
            latency_s=config.latency_s,
            jitter_s=config.jitter_s,
            loss=config.loss,
            bandwidth=math.inf if config.bandwidth is None else config.bandwidth,
        )
        slowest_s = config.latency_s + config.jitter_s
        effect = f"delayed by {config.latency_s:g} to {slowest_s:g} s"
        effect += f", {config.loss:.1%} sent again" if config.loss else ""
        effect += f", {config.bandwidth:g} bytes/s" if config.bandwidth is not None else ""
        with link.disturbed(conditions, random.getrandbits(32)):
            yield Injection(link.name, f"{effect}, for {lasts_s:g} s", lasts_s)


def _drawn(robot: CampaignRobot, config: LinkConfig, random: Random) -> Link:
    links = robot.network.links
    if not links:
        raise SkippedFault("the deployment has no links: it has no `machines`")
    names = matching(links, config.links)
    if not names:
        known = ", ".join(links)
        raise SkippedFault(f"no link matches {', '.join(config.links)}; its links: {known}")
    return links[random.choice(names)]
