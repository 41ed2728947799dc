"""Atomic checkpoints that hold tensors and plain values only."""

from __future__ import annotations

import pickletools
import re
import zipfile
from pathlib import Path
from typing import Any

import torch

from deepkoco.agent.config import flatten
from deepkoco.output.whole_file import whole_file

FORMAT_VERSION = 2
_KNOWN = re.compile(
    r"collections (OrderedDict|Counter)|__builtin__ (set|complex)|_codecs encode|"
    r"torch\._utils _rebuild_(tensor_v2|parameter)|torch (\w+Storage|Size|bool|\w+\d)"
)
"""What the pickle in a checkpoint may ask for: plain values and tensors, no more than is stored."""


class CheckpointError(ValueError):
    """A checkpoint is missing or does not fit."""


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint so that a kill at any moment leaves the old or the new file, whole.

    Args:
        path: Target file.
        state: Tensors and plain values; generator states as byte tensors.

    Raises:
        WriteError: The disk is full, or the place cannot be written.
    """
    with whole_file(path) as partial, partial.open("wb") as file:
        torch.save({"version": FORMAT_VERSION, **state}, file)


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint without running any code from it.

    Args:
        path: File written by `save_checkpoint`.

    Returns:
        The saved state.

    Raises:
        CheckpointError: There is no such file, it is damaged, or another version wrote it.
    """
    if not path.is_file():
        raise CheckpointError(f"{path}: no checkpoint; the run has not saved one yet, start it anew")
    try:
        # torch does not compare the checksums that it writes: a flipped bit of a weight would go unnoticed.
        with zipfile.ZipFile(path) as archive:
            _check_bounds(path, archive)
            if (entry := archive.testzip()) is not None:
                raise zipfile.BadZipFile(f"the checksum of {entry} does not fit")
        state = torch.load(path, weights_only=True, map_location="cpu")
        _check_tensors(state)
    # A damaged archive or pickle fails with whatever its bytes happen to ask for.
    except Exception as error:
        raise damaged(path, error) from error
    if not isinstance(state, dict):
        raise CheckpointError(
            f"{path}: damaged, it holds no named entries; start the run anew in another folder"
        )
    if state.pop("version", None) != FORMAT_VERSION:
        raise CheckpointError(
            f"{path}: written by another version of the format; this release reads {FORMAT_VERSION}"
        )
    return state


def _check_bounds(path: Path, archive: zipfile.ZipFile) -> None:
    """Refuse an archive that would take more memory than its file has bytes, before anything is unpacked."""
    entries = archive.infolist()
    # torch.save does not compress.
    packed = next((entry.filename for entry in entries if entry.compress_type != zipfile.ZIP_STORED), None)
    if packed is not None:
        raise zipfile.BadZipFile(f"{packed[:80]} is compressed, which no checkpoint is")
    total, size = sum(entry.file_size for entry in entries), path.stat().st_size
    if total > size:
        raise zipfile.BadZipFile(f"its entries have {total} bytes, the file {size}")
    for entry in entries:
        if entry.filename.endswith("data.pkl"):
            _check_pickle(archive.read(entry))


def _check_pickle(content: bytes) -> None:
    """Refuse what a checkpoint does not need: a call such as bytearray(10**11) would reserve memory."""
    for opcode, argument, _ in pickletools.genops(content):
        if opcode.name == "GLOBAL" and not _KNOWN.fullmatch(str(argument)):
            raise zipfile.BadZipFile(f"it asks for {str(argument)[:80]!r}, which no checkpoint holds")


def _check_tensors(state: Any) -> None:
    """Refuse tensors that repeat what is stored, as a view with step 0 does, to any size."""
    left, seen = [state], set()
    while left:
        value = left.pop()
        if id(value) in seen:
            continue
        seen.add(id(value))
        if isinstance(value, torch.Tensor):
            if value.numel() * value.element_size() > value.untyped_storage().nbytes():
                raise zipfile.BadZipFile(
                    f"a tensor of shape {tuple(value.shape)} has more numbers than are stored"
                )
        elif isinstance(value, dict):
            left += value.values()
        elif isinstance(value, list | tuple):
            left += value


def damaged(path: Path, error: Exception) -> CheckpointError:
    """The error to raise for a file whose bytes are not those that were written.

    Args:
        path: The file.
        error: What reading it raised.

    Returns:
        One sentence with the remedy.
    """
    reason = (str(error).splitlines() or [""])[0][:150]
    return CheckpointError(
        f"{path}: damaged ({type(error).__name__}: {reason}); start the run anew in another folder"
    )


def check_settings(
    path: Path,
    state: dict[str, Any],
    config: dict[str, Any],
    seed: int,
    defaults: dict[str, Any] | None = None,
) -> None:
    """Check that a checkpoint was made with the settings it is to go on with.

    Args:
        path: The checkpoint, for the message.
        state: As given by `load_checkpoint`; one that holds no settings passes.
        config: Nested settings of the run.
        seed: The run's seed.
        defaults: Nested values of the settings that are younger than the checkpoint.

    Raises:
        CheckpointError: Names the settings that differ, with both values.
    """
    own = flatten({"seed": seed, **config})
    stored = flatten({"seed": state.get("seed", seed), **state.get("config", {})})
    if "config" in state:
        stored = {n: v for n, v in flatten(defaults or {}).items() if n in own} | stored
    differing = [name for name in stored if name not in own or own[name] != stored[name]]
    if differing:
        texts = (f"{name} = {stored[name]!r} instead of {own.get(name)!r}" for name in differing)
        raise CheckpointError(
            f"{path}: made with {', '.join(texts)}; continue with those settings or choose another folder"
        )
