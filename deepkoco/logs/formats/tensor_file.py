"""Read logs that torch stored: a dictionary of tensors with a common first dimension, as PACE writes them."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from deepkoco.logs.formats.fields import MOST_CELLS, MOST_ELEMENTS, NAME_LISTS
from deepkoco.logs.formats.list_cells import element_names
from deepkoco.logs.formats.log_file import LogError, LogFile, Table

LARGEST = 1 << 31
"""Most bytes that the file may unpack to."""
TIMES = ("time", "t", "timestamp", "timestamps")
_NAMED = (*NAME_LISTS, "joint_order", "dof_names")


def read_tensors(path: Path) -> LogFile:
    """Read a `.pt`: `time` (T,), and tensors (T,) or (T, J) such as `dof_pos` and `des_dof_pos` of PACE.

    Elements are named after a list of names in the file (`joint_names`, `joint_order`), else numbered.

    Raises:
        LogError: the file is damaged, too large, contains other objects than tensors, or has no time.
    """
    content = _load(path)
    if not isinstance(content, Mapping):
        raise LogError(
            f"{path}: contains a {type(content).__name__}; save a dictionary with time (T,) and signals (T, J)"
        )
    time = next((key for key in TIMES if key in content), None)
    if time is None:
        found = ", ".join(map(str, list(content)[:20]))
        raise LogError(f"{path}: has no tensor {' or '.join(TIMES[:2])} of the stamps [s]; it has {found}")
    names = next(
        (tuple(map(str, content[key])) for key in _NAMED if isinstance(content.get(key), list | tuple)), ()
    )
    columns: dict[str, np.ndarray] = {}
    left_out: dict[str, str] = {}
    arrays = {str(key): _array(value) for key, value in content.items()}
    count = sum(array.numel() for array in arrays.values() if array is not None)
    if count > MOST_CELLS:
        raise LogError(f"{path}: has {count} values, more than the limit {MOST_CELLS}; split the log")
    stamps = arrays[time]
    if stamps is None or stamps.dim() != 1:
        raise LogError(f'{path}: "{time}" is no vector of stamps; save a tensor (T,) [s]')
    for name, array in arrays.items():
        if array is None or array.dim() not in (1, 2) or len(array) != len(stamps):
            shape = "no tensor" if array is None else f"its shape is {tuple(array.shape)}"
            left_out[name] = f"{shape}, not ({len(stamps)},) or ({len(stamps)}, J)"
        elif array.dim() == 1:
            columns[name] = array.double().numpy()
        elif array.shape[1] > MOST_ELEMENTS:
            left_out[name] = f"{array.shape[1]} elements"
        else:
            labels = element_names(name, array.shape[1], names)
            columns |= dict(zip(labels, array.double().numpy().T, strict=True))
    table = Table(pd.DataFrame(columns), "", (time,), left_out=left_out)
    return LogFile(path, "tensors", {"": table}, row_name="row")


def _load(path: Path) -> Any:
    import torch

    with path.open("rb"):  # a file that cannot be opened is no damaged file
        pass
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                size = sum(part.file_size for part in archive.infolist())
        else:
            size = path.stat().st_size
        if size > LARGEST:
            raise LogError(f"{path}: unpacks to {size} bytes, more than the limit {LARGEST}; split the log")
        return torch.load(path, map_location="cpu", weights_only=True)
    except LogError:
        raise
    except Exception as error:  # the library raises errors of many kinds on damaged files
        reason = " ".join(str(error).split())
        if "weights_only" in reason or "Unsupported" in reason:
            raise LogError(
                f"{path}: contains other objects than tensors, numbers and texts, which are not loaded; save a "
                "dictionary of tensors with torch.save"
            ) from error
        raise LogError(f"{path}: truncated or not a file of torch: {reason[:160]}; copy it again") from error


def _array(value: Any) -> Any:
    """The value as a real tensor; None if it is not one."""
    import torch

    if isinstance(value, list | tuple) and value and all(isinstance(v, int | float) for v in value):
        value = torch.tensor(value, dtype=torch.float64)
    if not isinstance(value, torch.Tensor) or value.is_complex() or value.is_sparse or value.is_quantized:
        return None
    return value.detach()
