"""The command line `deepkoco`: one file for each subcommand."""

from deepkoco.cli.command_line import main

__all__ = ["main"]
