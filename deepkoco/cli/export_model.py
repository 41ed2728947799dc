"""`deepkoco export-model`: write a trained or imported model for other programs."""

from __future__ import annotations

import argparse

from deepkoco.cli.input_error import InputError

DESCRIPTION = """\
Export a model for other programs: ONNX or torch.export of (observation, action) -> (latent, B, C), or plain
arrays (.npz, .mat, .json) for your own controller."""
EXAMPLE = """\
example:
  deepkoco export-model runs/first --to onnx --out first.onnx
  deepkoco export-model runs/first --to arrays --out first.mat"""
FORMS = ("onnx", "torch", "arrays")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments.

    Args:
        parser: Parser of the subcommand.
    """
    parser.add_argument("model", metavar="RUN", help="folder of a run or a model, or ORG/NAME of the hub")
    parser.add_argument("--to", required=True, choices=FORMS, help="format")
    parser.add_argument("--out", required=True, metavar="FILE", help="new file")


def run(arguments: argparse.Namespace) -> int:
    """Export.

    Args:
        arguments: As declared by `add_arguments`.

    Returns:
        Exit status 0.

    Raises:
        InputError: The model or the file cannot be used.
    """
    # Imported here so that --help is fast.
    from deepkoco.interchange.exporters import ExportError, export
    from deepkoco.interchange.hub import HubError
    from deepkoco.interchange.loaded_model import load
    from deepkoco.koopman.files.model_folder import ModelFolderError

    try:
        export(load(arguments.model), arguments.to, arguments.out)
    except (ModelFolderError, HubError, ExportError) as error:
        raise InputError(str(error)) from error
    print(f"wrote {arguments.out}")
    return 0
