"""Topics chosen by patterns."""

from __future__ import annotations

import re
from collections.abc import Sequence


class TopicPatterns:
    """Topics chosen by patterns: `*` stands for any characters within a name, `**` for any levels.

    A pattern that does not begin with / belongs to the robot, or to every robot if that is "".
    """

    def __init__(self, patterns: Sequence[str], robot: str = "") -> None:
        self.patterns = [
            pattern if pattern.startswith("/") else f"/{robot or '*'}/{pattern}"
            for pattern in patterns
        ]
        self._regex = re.compile("|".join(map(_pattern_regex, self.patterns)) or r"(?!)")

    def match(self, topic: str) -> bool:
        """Return whether a topic (full name) is chosen."""
        return self._regex.fullmatch(topic) is not None


def _pattern_regex(pattern: str) -> str:
    parts = ""
    for chunk in pattern.strip("/").split("/"):
        name = re.escape(chunk).replace(r"\*", "[^/]*")
        parts += "(?:/[^/]+)*" if chunk == "**" else f"/{name}"
    return parts
