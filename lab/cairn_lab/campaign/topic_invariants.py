"""Invariants of topics of any deployment."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from cairn.deployment.model import Deployment
from cairn.runtime.parameters import Config
from cairn.schemas.interfaces import find_message
from cairn_lab.campaign.invariants import Invariant
from cairn_lab.campaign.observations import Processes


def _message_class(name: object) -> type[Any]:
    found = find_message(str(name))
    if found is None:
        raise ValueError(f"there is no message type {name}; `cairn schema list` lists all")
    return found


class PublishingConfig(Config):
    """Parameters of `keeps_publishing`."""

    topics: dict[str, Annotated[type[Any], BeforeValidator(_message_class)]] = Field(
        min_length=1,
        max_length=100,
        description="Topics and the types of their messages, such as `scan: "
        "sensor_msgs/msg/LaserScan`.",
    )
    patience_s: float = Field(
        30.0,
        gt=0,
        le=3600,
        description="Longest time without a message [s]; longer than the faults that silence it.",
    )


class KeepsPublishing(Invariant):
    """Messages arrive on each of the topics, again after each fault."""

    config_type = PublishingConfig
    config: PublishingConfig

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.topics = self.config.topics
        self._arrived_s: dict[str, float] = {}

    def on_start(self, at_s: float, deployment: Deployment) -> Iterable[str]:
        """Expect messages from now on."""
        self._arrived_s = dict.fromkeys(self.topics, at_s)
        return ()

    def on_message(self, at_s: float, topic: str, message: Any) -> Iterable[str]:
        """Note that one has arrived."""
        self._arrived_s[topic] = at_s
        return ()

    def on_processes(self, at_s: float, processes: Processes) -> Iterable[str]:
        """Judge, once a second."""
        for topic, arrived_s in self._arrived_s.items():
            if at_s - arrived_s > self.config.patience_s:
                self._arrived_s[topic] = at_s  # reported again only after as long
                yield f"nothing was published on {topic} for {at_s - arrived_s:.0f} s"
