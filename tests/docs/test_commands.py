"""Every command that a text names parses with today's options: pages, README and the records of results."""

import argparse
import importlib.util
import re
import runpy
import shlex
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, NoReturn

import pytest
from hydra import compose, initialize_config_dir
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser

from deepkoco.cli import train
from deepkoco.cli.command_line import COMMANDS
from deepkoco.runs import hydra_command
from deepkoco.runs.configs import CONFIGS

ROOT = Path(__file__).parents[2]
TEXTS = sorted(
    [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/*.md"), *ROOT.glob("results/**/*.md")]
)
PROGRAMS = r"python -m (?:experiments|deepkoco|baselines)\b", rf"deepkoco (?:{'|'.join(COMMANDS)})(?=\s|$)"
BEGIN = re.compile("|".join(PROGRAMS))


class Command(NamedTuple):
    """A command of a text.

    Attributes:
        text: Path of the text below the root.
        words: Module, or the name of a subcommand behind ``deepkoco``, and its arguments.
    """

    text: str
    words: tuple[str, ...]


class Parsed(Exception):
    """The arguments are read; nothing else of the command is to run."""


def commands_in(text: str) -> Iterator[tuple[str, ...]]:
    """Commands with arguments, of blocks of code and of code within a line."""
    text = text.replace("\\\n", " ")
    blocks = re.findall(r"```\w*\n(.*?)```", text, re.DOTALL)
    spans = re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    for line in [line for block in blocks for line in block.splitlines()] + spans:
        for part in re.split(r"; (?=deepkoco|python)", line):
            begin = BEGIN.search(part)
            # Before a command there may be variables, as in "OMP_NUM_THREADS=1 python -m ..." or 'H="python -m ...".
            if begin is None or not re.fullmatch(
                r"(\s*(\$|H=\"|\w+=\w+|cd \w+;))*\s*", part[: begin.start()]
            ):
                continue
            said = part[begin.start() :].removesuffix('"') if 'H="' in part else part[begin.start() :]
            said = re.sub(r"\s\[[^\]]*\]", "", said)  # what may be left out
            words = shlex.split(re.split(r"\s[>|] |\s#", said)[0])
            words = words[2:] if words[0] == "python" else words
            if len(words) > 1 + (words[0] == "deepkoco"):
                yield tuple(w for w in words if w != "...")


COMMANDS_OF_TEXTS = sorted(
    {
        Command(str(path.relative_to(ROOT)), words)
        for path in TEXTS
        for words in commands_in(path.read_text(encoding="utf-8"))
    }
)


def stop_behind_the_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let commands end with `Parsed` as soon as they have read their arguments."""
    plain = argparse.ArgumentParser.parse_args

    def parse(parser, *args, **kwargs) -> NoReturn:
        plain(parser, *args, **kwargs)
        raise Parsed

    def hydra_main(config_name: str, **_: object):
        def stand_in(entry: object):
            def settings() -> NoReturn:
                given = [a for a in sys.argv[1:] if a not in ("-m", "--multirun")]
                sweep = len(given) < len(sys.argv) - 1
                if "--config-dir" in given:  # a folder of one's own
                    raise Parsed
                GlobalHydra.instance().clear()
                with initialize_config_dir(str(CONFIGS), version_base="1.3"):
                    parser = OverridesParser.create()
                    read = parser.parse_overrides(given)
                    first = BasicSweeper.split_arguments(read, None)[0][0] if sweep else given
                    compose(config_name, [a for a in first if not a.startswith("hydra/")])
                raise Parsed

            return settings

        return stand_in

    def without_robot(words: Sequence[str]) -> list[str]:
        """The robot and the task of a page are no files here."""
        values = [k + 1 for k, word in enumerate(words) if word in ("--system", "--task")]
        rest = [w for k, w in enumerate(words) if k not in values and k + 1 not in values]
        return ["task=robot", *rest] if values else rest

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse)
    monkeypatch.setattr(train, "with_robot", without_robot)
    monkeypatch.setattr(hydra_command, "check_launcher", lambda arguments: None)  # launchers are extras
    monkeypatch.setattr(hydra_command.hydra, "main", hydra_main)


def test_commands_are_found_in_blocks_and_in_lines():
    text = """Call `deepkoco diagnose LOG --out X`, or `deepkoco show`.
```
A=1 python -m experiments.train -m seed=0,1 \\
    'run=r/${seed}' > a.json   # long
cd arm; deepkoco systems arm.xml
import deepkoco train
```
"""
    assert list(commands_in(text)) == [
        ("experiments.train", "-m", "seed=0,1", "run=r/${seed}"),
        ("deepkoco", "systems", "arm.xml"),
        ("deepkoco", "diagnose", "LOG", "--out", "X"),
    ]


@pytest.mark.parametrize("command", COMMANDS_OF_TEXTS, ids=lambda c: f"{c.text}: {' '.join(c.words)[:70]}")
def test_a_command_of_a_text_parses(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    stop_behind_the_arguments(monkeypatch)
    module, *arguments = command.words
    monkeypatch.setattr(sys, "argv", [module, *arguments])
    if command.words[:2] == ("deepkoco", "evaluate"):
        (tmp_path / command.words[2]).mkdir(parents=True)
        monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert importlib.util.find_spec(module) is not None
        with pytest.raises((Parsed, SystemExit)) as end:
            runpy.run_module("deepkoco.cli" if module == "deepkoco" else module, run_name="__main__")
    assert end.type is Parsed, capsys.readouterr().err
