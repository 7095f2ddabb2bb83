"""Checks of messages by their essential words: component or file, value, and remedy.

A test states what a message must say, not its whole sentence, so that the sentence can be improved.
"""

import re


def assert_words(message: str, *words: str) -> None:
    """Assert that a message contains all these words, in this order."""
    assert re.search(words_in_order(*words), message), f"{words} are not in {message!r}"


def words_in_order(*words: str) -> str:
    """Return a pattern for messages that contain all these words in this order, for `match=`."""
    return "(?s)" + ".*".join(map(re.escape, words))
