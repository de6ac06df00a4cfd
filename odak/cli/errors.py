"""The error that the command line reports in one line."""


class InputError(Exception):
    """What the user asked for cannot be done; the message says what and what would be accepted."""
