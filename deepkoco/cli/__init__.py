"""The command line `deepkoco`: one file for each subcommand."""

from deepkoco.cli.command_line import COMMANDS, build_parser, main

__all__ = ["COMMANDS", "build_parser", "main"]
