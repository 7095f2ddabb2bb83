"""The base class of all errors that Cairn raises, and the one that makes a supervisor fail."""


class CairnError(Exception):
    """An error whose message says what is wrong, with the value, and what to do about it."""


class Escalate(CairnError):
    """A supervisor has given up and stopped all children: it must fail itself."""


class LoggedFailure(CairnError):
    """The failure of a child, which the log already has: its supervisor fails because of it."""


class RecordingError(CairnError):
    """A recording is missing, damaged or of another format."""
