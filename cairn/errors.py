"""The root of all errors that Cairn raises."""


class CairnError(Exception):
    """An error whose message is a sentence that an operator can act on."""


class StoppedByForce(CairnError):  # noqa: N818 - says what happened
    """Whoever asked for a stop did not wait for its end: threads of this process still work."""
