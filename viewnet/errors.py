"""The one exception that a user's mistake raises."""


class ViewnetError(ValueError):
    """A problem the user can mend: names the value or file at fault, what was expected and what to do, in one line."""
