"""Error of wrong input, shared by the subcommands."""


class InputError(ValueError):
    """Input of the user is wrong. The command prints one line and exits with status 2."""
