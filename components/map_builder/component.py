"""The component MapBuilder: owns the visual map, its reliabilities and its file."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from pydantic import Field

from cairn.bus.qos import LATCHED, RELIABLE
from cairn.clock import from_ns, to_ns
from cairn.component.component import Component
from cairn.component.handlers import every, on
from cairn.component.parameters import Config, ParameterRefused
from cairn.component.ports import In, Out
from components.map_builder.keeper import MapKeeper, NumberedChange
from components.map_builder.messages import change_message, evidence_of, map_message
from components.map_builder.objects import Kind
from components.map_builder.store import open_map
from schemas.cairn_msgs import ObjectEvidenceArray, VisualMap, VisualMapChange
from schemas.geometry_msgs import PoseWithCovarianceStamped


class MapBuilderConfig(Config):
    """Parameters of the map builder."""

    map_file: Path = Field(description="The visual map: a file made by `cairn map import`.")
    working_copy: Path | None = Field(
        None,
        description="Where to keep a copy that is changed instead of map_file; none: change "
        "map_file itself. A copy of the same map, not later than now, is gone on with.",
    )
    learn_unknown: bool = Field(
        True, description="Whether to place objects that are sighted but not in the map."
    )


class MapBuilder(Component):
    """Judges each object of the visual map by the evidence for it; removes and registers."""

    config: MapBuilderConfig
    object_evidence: In[ObjectEvidenceArray] = In(qos=RELIABLE.with_depth(200))
    relocalised: In[PoseWithCovarianceStamped] = In(optional=True)
    visual_map: Out[VisualMap] = Out(qos=LATCHED)
    visual_map_changes: Out[VisualMapChange] = Out(qos=RELIABLE.with_depth(100))

    _keeper: MapKeeper | None = None

    def on_configure(self) -> None:
        """Check the map file, so that a wrong one is told of before anything moves."""
        open_map(self.config.map_file, read_only=True).close()

    def on_activate(self) -> None:
        """Open the map and publish it, if it is known what time it is."""
        if self.clock.now() > 0:
            self._open()

    def on_deactivate(self) -> None:
        """Commit what is left."""
        if self._keeper is not None:
            self._keeper.close()
            self._keeper = None

    def on_error(self, error: Exception) -> bool:  # noqa: ARG002 - any error ends it
        """Let go of the file; what was committed is safe."""
        if self._keeper is not None:
            keeper, self._keeper = self._keeper, None
            keeper.abandon()
        return False

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """Files cannot be exchanged under a map in use."""
        raise ParameterRefused("the map builder takes its parameters when it is configured")

    @on("object_evidence")
    def judge(self, frame: ObjectEvidenceArray) -> None:
        """Take one frame's evidence."""
        keeper = self._open()
        stamp_ns = to_ns(frame.header.stamp)
        self._tell(stamp_ns, *keeper.apply(stamp_ns, evidence_of(frame)))

    @on("relocalised")
    def take_back(self, pose: PoseWithCovarianceStamped) -> None:
        """Undo what the robot judged while it was lost."""
        keeper = self._open()
        stamp_ns = to_ns(pose.header.stamp)
        self._tell(stamp_ns, *keeper.take_back(stamp_ns))

    @every(hz=1)
    def save(self) -> None:
        """Open the map once time is known; commit the evidence of the last second."""
        if self.clock.now() > 0:
            self._open().save_pending()

    def _open(self) -> MapKeeper:
        if self._keeper is None:
            config = self.config
            now = self.clock.now()
            self._keeper = MapKeeper(
                config.map_file, config.working_copy, now, config.learn_unknown
            )
            self._tell(now, True, [])
        return self._keeper

    def _tell(self, stamp_ns: int, touched: bool, changes: Sequence[NumberedChange]) -> None:
        keeper = self._keeper
        if keeper is None or not (touched or changes):
            return
        stamp = from_ns(stamp_ns)
        for version, change in changes:
            level = logging.DEBUG if change.kind is Kind.REFINED else logging.INFO
            self.log.log(
                level, "object %d %s: %s", change.object_id, change.kind.name, change.reason
            )
            self.visual_map_changes.publish(change_message(stamp, version, change))
        self.visual_map.publish(map_message(stamp, keeper.version, keeper.objects))
