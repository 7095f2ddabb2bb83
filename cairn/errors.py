"""The base class of all errors that Cairn raises."""


class CairnError(Exception):
    """An error whose message says what is wrong, with the value, and what to do about it."""
