"""A component that publishes numbers, and ends the run with the last one."""

from cairn import LATCHED, Component, Out, every
from cairn.schemas.std_msgs import String

LAST = 30


class Ticker(Component):
    number: Out[String]
    name_plate: Out[String] = Out(qos=LATCHED)

    _sent = 0

    def on_activate(self) -> None:
        self.name_plate.publish(String(data="ticker"))

    @every(hz=10)
    def tick(self) -> None:
        self._sent += 1
        self.number.publish(String(data=str(self._sent)))
        if self._sent == LAST:
            self.finish("counted")
