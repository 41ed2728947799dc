"""Read logs that array programs stored: archives of NumPy, files of MATLAB, HDF5."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.extras import install_command
from deepkoco.logs.formats.array_tables import TIMES, is_time, tables_of
from deepkoco.logs.formats.fields import MOST_CELLS, MOST_ELEMENTS, NAME_LISTS
from deepkoco.logs.formats.log_file import LogError, LogFile

LARGEST = 1 << 31  # most bytes that a file may unpack to
HDF5 = b"\x89HDF\r\n\x1a\n"  # how an HDF5 file begins, at 0 or behind a block of 512 bytes
LONGEST_FACT = 200  # letters of a text that is told as a fact


def looks_like_arrays(path: Path) -> bool:
    """Whether a file of arrays names a time, a period or a rate; one that cannot be opened does not."""
    suffix = path.suffix.lower()
    try:
        if suffix == ".npz":
            with zipfile.ZipFile(path) as archive:
                names = [part.filename.removesuffix(".npy") for part in archive.infolist()]
        elif suffix == ".mat" and not _is_hdf5(path):
            names = [name for name, _ in _flat(_load_mat(path))]
        else:
            names = _names(path)
    except ImportError:
        return True  # reading it says what is missing
    except Exception:  # the libraries raise errors of many kinds on damaged files
        return False
    return any(is_time(name.replace("/", ".")) for name in names)


def read_npz(path: Path) -> LogFile:
    """Read a `.npz` of `numpy.savez`. Objects are not loaded, because unpacking them can run code.

    Raises:
        LogError: The file is damaged or too large, or has no time.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            _bound(path, sum(part.file_size for part in archive.infolist()))
        with np.load(path, allow_pickle=False) as archive:
            content = {name.replace("/", "."): _entry(archive, name) for name in archive.files}
    except LogError:
        raise
    except OSError as error:
        if error.errno is not None:
            raise
        raise _damaged(path, "archive of NumPy", error) from error
    except Exception as error:  # the library raises errors of many kinds on damaged files
        raise _damaged(path, "archive of NumPy", error) from error
    return _log(path, "NumPy archive", content)


def read_mat(path: Path) -> LogFile:
    """Read a `.mat` of MATLAB or Octave; structures give names with dots, ``out.signals.values``.

    Raises:
        LogError: The file is damaged or too large, or has no time.
    """
    if _is_hdf5(path):
        return read_hdf5(path, "MATLAB file 7.3")
    try:
        content = _load_mat(path)
    except (LogError, PermissionError, FileNotFoundError):
        raise
    except Exception as error:  # the library raises errors of many kinds on damaged files
        raise _damaged(path, "file of MATLAB", error) from error
    return _log(path, "MATLAB file", content)


def read_hdf5(path: Path, form: str = "HDF5") -> LogFile:
    """Read an HDF5 file; groups give names with dots, ``arm.position``.

    Raises:
        LogError: h5py is missing, or the file is damaged, too large, or has no time.
    """
    try:
        content = _entries(path)
    except ImportError as error:
        raise LogError(f"{path}: {form} needs h5py: {install_command('hdf5')}") from error
    except (LogError, PermissionError, FileNotFoundError):
        raise
    except Exception as error:  # the library raises errors of many kinds on damaged files
        raise _damaged(path, "HDF5 file", error) from error
    return _log(path, form, content)


def _load_mat(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat, whosmat

    cells = sum(int(np.prod(shape, dtype=object)) for _, shape, _ in whosmat(path))
    _bound(path, 8 * cells)
    return {k: v for k, v in loadmat(path, simplify_cells=True).items() if not k.startswith("__")}


def _entries(path: Path) -> dict[str, Any]:
    """Arrays and attributes of an HDF5 file; images and other arrays with too many numbers a sample are left out."""
    import h5py

    arrays: dict[str, Any] = {}
    told: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        name = name.replace("/", ".")
        if name.startswith("#"):  # what MATLAB keeps for itself
            return
        if isinstance(item, h5py.Group):
            told.update({f"{name}.{key}": value for key, value in item.attrs.items() if "MATLAB" not in key})
        elif item.ndim < 3 or (item.ndim == 3 and item.shape[-1] <= MOST_ELEMENTS):
            arrays[name] = item

    with h5py.File(path, "r") as file:
        file.visititems(visit)
        _bound(path, sum(int(item.nbytes) for item in arrays.values()))
        return {**dict(file.attrs.items()), **told, **{name: _text(item) for name, item in arrays.items()}}


def _names(path: Path) -> list[str]:
    """Names of what is in an HDF5 file, without reading any of it."""
    import h5py

    names: list[str] = []
    with h5py.File(path, "r") as file:
        file.visititems(lambda name, item: names.extend([name, *(f"{name}/{key}" for key in item.attrs)]))
        return [*names, *file.attrs]


def _text(item: Any) -> Any:
    """Content of an entry of an HDF5 file; MATLAB stores a text as the codes of its letters."""
    value = item[()]
    if item.attrs.get("MATLAB_class") == b"char":
        return "".join(map(chr, np.asarray(value).T.reshape(-1)))
    return value


def _entry(archive: Any, name: str) -> Any:
    try:
        return archive[name]
    except ValueError:  # an array of objects
        return None


def _log(path: Path, form: str, content: Mapping[str, Any]) -> LogFile:
    arrays: dict[str, np.ndarray] = {}
    scalars: dict[str, float] = {}
    texts: dict[str, str] = {}
    labels: dict[int, tuple[str, ...]] = {}
    left_out: list[str] = []
    for name, value in _flat(content):
        array = _plain(value)
        if array is None or array.size == 0:
            left_out.append(name)
        elif array.dtype.kind == "U":
            words = tuple(str(word).strip() for word in array.reshape(-1))
            if array.ndim and name.rpartition(".")[2].lower() in (*NAME_LISTS, "joint_order"):
                labels[len(words)] = words
            elif array.size == 1 and len(words[0]) <= LONGEST_FACT:
                texts[name] = words[0]
            elif array.ndim == 1 and name.rpartition(".")[2].lower() in TIMES:
                arrays[name] = array  # dates
        elif array.size == 1 and array.dtype.kind != "M":
            scalars[name] = float(array.reshape(-1)[0])
        else:
            arrays[name] = array
    if (count := sum(array.size for array in arrays.values())) > MOST_CELLS:
        raise LogError(f"{path}: has {count} values, more than the limit {MOST_CELLS}; split the log")
    tables, notes = tables_of(path, arrays, scalars, labels)
    if left_out:
        notes = (*notes, f"not read, because they are no arrays of numbers: {', '.join(left_out[:10])}")
    return LogFile(path, form, tables, row_name="row", notes=notes, facts={**scalars, **texts})


def _flat(content: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Names and values of nested structures; elements of a list of structures are counted."""
    if isinstance(content, Mapping):
        for key, value in content.items():
            yield from _flat(value, f"{name}.{key}" if name else str(key))
    elif isinstance(content, np.ndarray) and content.dtype.names:
        for key in content.dtype.names:
            yield from _flat(content[key], f"{name}.{key}" if name else key)
    elif _are_structures(content):
        for number, value in enumerate(content):
            yield from _flat(value, f"{name}{number}")
    else:
        yield name, content


def _are_structures(value: Any) -> bool:
    many = isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.dtype == object)
    return many and len(value) > 0 and all(isinstance(entry, Mapping) for entry in value)


def _plain(value: Any) -> np.ndarray | None:
    """The value as an array of numbers, dates or texts; None if it is none."""
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    try:
        array = np.asarray(value)
    except (ValueError, TypeError):
        return None
    if array.dtype.kind == "O" and all(isinstance(entry, str | bytes) for entry in array.reshape(-1)):
        array = np.array(
            [e.decode("utf-8", "replace") if isinstance(e, bytes) else e for e in array.reshape(-1)]
        )
    if array.dtype.kind == "S":
        array = np.char.decode(array, "utf-8", "replace")
    return array if array.dtype.kind in "biufUM" else None


def _is_hdf5(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(520)
    return head.startswith(HDF5) or head[512:] == HDF5


def _bound(path: Path, size: int) -> None:
    if size > LARGEST:
        raise LogError(f"{path}: unpacks to {size} bytes, more than the limit {LARGEST}; split the log")


def _damaged(path: Path, what: str, error: Exception) -> LogError:
    reason = " ".join(str(error).split())[:160]
    return LogError(f"{path}: truncated or no {what}: {reason}; copy it again")
