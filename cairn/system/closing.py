"""A context manager that is closed at its end."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Self


class Closing(ABC):
    """What `close` ends, and so does the end of a `with` statement."""

    @abstractmethod
    def close(self) -> None:
        """End it; a second call has no effect."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
