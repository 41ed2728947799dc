"""What the subcommands share."""


class InputError(ValueError):
    """What the user gave cannot be used; shown as one line, exit status 2."""
