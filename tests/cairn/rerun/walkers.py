"""Components whose re-run must be exact: with timers, randomness, posts, requests and files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from cairn import CairnError, Component, Config, In, Out, ReadPath, every, from_ns, on
from cairn.schemas.geometry_msgs import Twist, TwistStamped, Vector3
from cairn.schemas.std_msgs import Header


class WalkerConfig(Config):
    step: float = Field(1.0, description="Length of a step [m].")
    names: ReadPath | None = Field(None, description="A file with words.")
    state_file: Path | None = Field(None, description="Keeps the position.")


class Walker(Component):
    """Walks at random; publishes where it is, stamped by its clock."""

    config: WalkerConfig
    push: In[TwistStamped] = In(optional=True)
    position: Out[TwistStamped]
    corner: Out[TwistStamped]

    x = 0.0

    def on_configure(self) -> None:
        if self.config.state_file is not None and self.config.state_file.exists():
            self.x = float(self.config.state_file.read_text())
        words = "" if self.config.names is None else self.config.names.read_text()
        self.x += len(words)

    @every(hz=10)
    def walk(self) -> None:
        self.x += self.config.step * float(self.random.normal())
        self.position.publish(self._at(self.x))
        if self.config.state_file is not None:
            self.config.state_file.write_text(str(self.x))

    @on("push")
    def receive_push(self, push: TwistStamped) -> None:
        before = self.clock.now()
        self.x += push.twist.linear.x / 3
        self.post(lambda: self.corner.publish(self._at(self.x)))
        self.schedule(before + 30_000_000, lambda: self.corner.publish(self._at(-self.x)))

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        if verb == "jump":
            self.x += arguments["by"]
            return self.x
        if verb == "fail":
            self.post(self._fail)
            return None
        return super().on_request(verb, arguments)

    def _fail(self) -> None:
        raise CairnError(f"broken at {self.x:.6f}")

    def _at(self, x: float) -> TwistStamped:
        return TwistStamped(
            header=Header(stamp=from_ns(self.clock.now())),
            twist=Twist(linear=Vector3(x=x, y=self.config.step)),
        )
