"""The root of all errors that Cairn raises."""


class CairnError(Exception):
    """An error whose message is a sentence that an operator can act on."""
