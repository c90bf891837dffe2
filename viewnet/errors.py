"""The exception for mistakes of the user."""


class ViewnetError(ValueError):
    """A problem the user can fix. The message, one line, names the value or file, what was expected and what to do."""
