"""A component that publishes numbers, and two that receive them."""

from pydantic import Field

from cairn import Component, Config, In, Out, ParameterRejected, every, on
from cairn.schemas.geometry_msgs import Twist, Vector3


class TalkerConfig(Config):
    """How many words are published."""

    words: int = Field(0, ge=0, description="Ends normally after this many words [1]; 0: never.")
    volume: int = Field(3, ge=0, le=11, description="Loudness [1]; above 10 the neighbors object.")


class Talker(Component):
    """Publishes the next number twenty times per second."""

    config: TalkerConfig
    words: Out[Twist] = Out()

    def on_activate(self) -> None:
        """Start at 1."""
        self._sent = 0

    @every(hz=20)
    def talk(self) -> None:
        """Publish the next number."""
        self._sent += 1
        self.words.publish(Twist(linear=Vector3(x=float(self._sent))))
        if self._sent == self.config.words:
            self.finish("all words sent")

    def on_parameters(self, new: Config) -> None:
        """Reject a volume above 10."""
        if isinstance(new, TalkerConfig) and new.volume > 10:
            raise ParameterRejected("volume: the neighbors object to more than 10")


class Listener(Component):
    """Logs the first and every tenth number."""

    words: In[Twist] = In(optional=True)

    def on_activate(self) -> None:
        """Reset the count."""
        self._received = 0

    @on("words")
    def receive(self, word: Twist) -> None:
        """Count the words."""
        self._received += 1
        if self._received == 1 or self._received % 10 == 0:
            self.log.info("received %d, the last was %g", self._received, word.linear.x)


class SentryConfig(Config):
    """When it fails."""

    fail_after: int = Field(3, ge=1, description="Fails after receiving this many words [1].")


class Sentry(Component):
    """Fails after receiving a number of words."""

    config: SentryConfig
    words: In[Twist] = In()

    def on_activate(self) -> None:
        """Reset the count."""
        self._received = 0

    @on("words")
    def receive(self, word: Twist) -> None:
        """Count the words; fail at the limit."""
        self._received += 1
        if self._received == self.config.fail_after:
            raise ValueError(f"received {self._received}")
