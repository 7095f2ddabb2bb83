"""A component that records its calls, and fails in the steps that a test selects."""

from typing import Any

from cairn import Component, In, Out, on
from cairn.runtime.component import ComponentContext
from cairn.schemas.std_msgs import String

STEPS = ("configure", "activate", "deactivate", "cleanup", "shutdown")
BOOM = "RuntimeError: boom"


class RecordingComponent(Component):
    """Records its calls, and fails in the steps that a test selects."""

    word: In[String]
    echo: Out[String]

    fails_in: frozenset[str] = frozenset()
    recovers: Any = False

    def __init__(self, context: ComponentContext) -> None:
        super().__init__(context)
        self.calls: list[str] = []

    def step(self, name: str) -> None:
        self.calls.append(name)
        if name in self.fails_in:
            raise RuntimeError("boom")

    def on_configure(self) -> None:
        self.step("configure")

    def on_activate(self) -> None:
        self.step("activate")

    def on_deactivate(self) -> None:
        self.step("deactivate")

    def on_cleanup(self) -> None:
        self.step("cleanup")

    def on_shutdown(self) -> None:
        self.step("shutdown")

    def on_error(self, error: Exception) -> bool:
        self.calls.append(f"error {error}")
        if isinstance(self.recovers, Exception):
            raise self.recovers
        return bool(self.recovers)

    @on("word")
    def receive(self, word: String) -> None:
        self.step(f"receive {word.data}")
        if word.data == "finish":
            self.finish("work is done")
        if word.data == "finish and fail":
            self.finish("work is done")
            raise RuntimeError("boom")
        if word.data == "exit":
            raise SystemExit(3)
        self.echo.publish(word)


def failing(*steps: str, recovers: Any = False) -> type[RecordingComponent]:
    return type(
        "Failing", (RecordingComponent,), {"fails_in": frozenset(steps), "recovers": recovers}
    )


def word(data: str) -> String:
    return String(data=data)
