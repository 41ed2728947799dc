"""Export of a loaded model for other programs: ONNX, torch.export, plain arrays."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.extras import install_command
from deepkoco.interchange.constants import controller_constants, network_arrays
from deepkoco.interchange.loaded_model import LoadedModel
from deepkoco.koopman.exported import ExportedModel
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel
from deepkoco.output.whole_file import whole_file

OUTPUTS = ("latent", "B", "C")


class ExportError(ValueError):
    """A model cannot be exported as asked."""


def description(model: LoadedModel) -> str:
    """Constants, task and training of a model as JSON, which travel inside an exported file.

    Args:
        model: The model.

    Returns:
        JSON text.
    """
    constants = {name: array.tolist() for name, array in controller_constants(model).items()}
    return json.dumps({**constants, "task": dict(model.task), "training": dict(model.training)})


def export_onnx(model: LoadedModel, path: Path) -> None:
    """Write (observation, action) -> (latent, B, C) as ONNX, in double precision and for any batch size.

    The metadata entry "deepkoco" holds `description(model)`.

    Args:
        model: A trained model, also EDMDc.
        path: The file.

    Raises:
        ExportError: The model has a lifting that is not known here, or the extra `onnx` is missing.
    """
    try:
        import onnx  # noqa: F401
        import onnxscript  # noqa: F401
    except ImportError as error:
        raise ExportError(f"ONNX needs two further packages: {install_command('onnx')}") from error
    import torch

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            _export_program(model),
            dynamo=True,
            input_names=["observation", "action"],
            output_names=list(OUTPUTS),
            verbose=False,
        )
        assert program is not None
        program.model.metadata_props["deepkoco"] = description(model)
        program.save(str(path))


def export_torch(model: LoadedModel, path: Path) -> None:
    """Write (observation, action) -> (latent, B, C) as a torch.export program (.pt2).

    The extra file "deepkoco.json" holds `description(model)`. torch.export.load is not safe for files of strangers:
    pass on the model's folder or ONNX instead.

    Args:
        model: A trained model, also EDMDc.
        path: The file.

    Raises:
        ExportError: The model has a lifting that is not known here.
    """
    import torch

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.export.save(_export_program(model), path, extra_files={"deepkoco.json": description(model)})


def _export_program(model: LoadedModel) -> Any:
    """The model traced by torch.export."""
    import torch

    from deepkoco.interchange.torch_lifted import LinearisedLiftedModel, UnknownLiftingError
    from deepkoco.interchange.torch_module import LinearisedModel

    latent_model, frames = model.latent_model, None
    if isinstance(latent_model, ExportedModel):
        module, frames = LinearisedModel(latent_model), latent_model.frame_encoder
    elif isinstance(latent_model, LiftedLinearModel):
        try:
            module = LinearisedLiftedModel(latent_model)
        except UnknownLiftingError as error:
            raise ExportError(
                f"{error} has no form in torch or ONNX; export the model with --to arrays"
            ) from error
    else:
        raise ExportError("this kind of model has no form in torch or ONNX; export it with --to arrays")
    size = latent_model.observation_size
    observation = torch.zeros((2, size), dtype=torch.float64)
    if frames is not None:
        observation = torch.zeros((2, frames.frames, *frames.frame_shape), dtype=torch.uint8)
    action = torch.zeros((2, latent_model.action_size), dtype=torch.float64)
    batch = torch.export.Dim("batch")
    return torch.export.export(module.eval(), (observation, action), dynamic_shapes=({0: batch}, {0: batch}))


def _write_npz(arrays: dict[str, Any], path: Path) -> None:
    with path.open("wb") as file:
        np.savez(file, **arrays)


def _write_mat(arrays: dict[str, Any], path: Path) -> None:
    from scipy.io import savemat

    savemat(str(path), arrays, appendmat=False)


def _write_json(arrays: dict[str, Any], path: Path) -> None:
    lists = {name: array.tolist() for name, array in arrays.items()}
    path.write_text(json.dumps(lists) + "\n", encoding="utf-8")


ARRAY_FILES: dict[str, Callable[[dict[str, Any], Path], None]] = {
    ".npz": _write_npz,
    ".mat": _write_mat,
    ".json": _write_json,
}
"""How arrays are written, by the file's ending."""


def export_arrays(model: LoadedModel, path: Path) -> None:
    """Write everything a controller of one's own needs as plain arrays.

    Args:
        model: Any model.
        path: The file; its ending is one of `ARRAY_FILES`.

    Raises:
        ExportError: The ending is unknown.
    """
    if path.suffix not in ARRAY_FILES:
        raise ExportError(
            f'"{path.suffix}" is no ending of arrays; they are written as {", ".join(ARRAY_FILES)}'
        )
    arrays = {**controller_constants(model), **network_arrays(model)}
    ARRAY_FILES[path.suffix]({name: np.asarray(array, np.float64) for name, array in arrays.items()}, path)


EXPORTERS: dict[str, Callable[[LoadedModel, Path], None]] = {
    "onnx": export_onnx,
    "torch": export_torch,
    "arrays": export_arrays,
}
"""Formats of `export`."""


def export(model: LoadedModel, form: str, path: str | Path) -> None:
    """Export a model into one new file, all or nothing.

    Args:
        model: The model.
        form: A name of `EXPORTERS`.
        path: The file; it must not exist.

    Raises:
        ExportError: The file exists, the format is unknown, or the model cannot be exported to it.
    """
    path = Path(path)
    if form not in EXPORTERS:
        raise ExportError(f'form = "{form}"; choose one of {", ".join(EXPORTERS)}')
    if path.exists():
        raise ExportError(f"{path}: exists already; choose another name")
    if not path.parent.is_dir():
        raise ExportError(f"{path}: there is no folder {path.parent}")
    with whole_file(path) as partial:
        EXPORTERS[form](model, partial)
