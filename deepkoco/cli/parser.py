"""Parser of `deepkoco` and its subcommands; for a mistyped option it prints usage and a proposal."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from deepkoco.suggestion import did_you_mean


class CommandParser(argparse.ArgumentParser):
    """An `ArgumentParser` that proposes an option for a mistyped one.

    argparse returns unknown arguments of a subcommand to the main parser, whose usage names no options.
    """

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        args = sys.argv[1:] if args is None else args
        # argparse would report a mistyped required option as missing. Subcommands parse their own arguments.
        for argument in [] if self._subparsers else args:
            if argument == "--":
                break
            option = argument.split("=")[0]
            if option.startswith("--") and not any(
                known.startswith(option) for known in self._long_options()
            ):
                self.refuse(argument)
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.refuse(unknown[0])
        return found, unknown

    def refuse(self, argument: str) -> NoReturn:
        """End with status 2, the usage and the most similar option.

        Args:
            argument: Argument that is unknown to this command.
        """
        if not argument.startswith("-"):
            self.error(f'"{argument}": one argument too many')
        option = argument.split("=")[0]
        suggestion = did_you_mean(option, self._long_options())
        self.error(f"there is no option {option}{suggestion or f'; {self.prog} --help lists them'}")

    def _long_options(self) -> list[str]:
        return [o for action in self._actions for o in action.option_strings if o.startswith("--")]
