"""Model folders on the Hugging Face hub."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from deepkoco.extras import install_command
from deepkoco.koopman.files.folder_files import CONFIG_FILE, WEIGHTS_FILE

PREFIX = "hf://"
_NAME = re.compile(r"(?P<repository>[\w.-]+/[\w.-]+)(@(?P<revision>[\w./-]+))?")


class HubError(ValueError):
    """A model could not be fetched from the hub."""


@dataclass(frozen=True)
class HubFolder:
    """A repository of the hub.

    Attributes:
        repository: "ORG/NAME".
        revision: Branch, tag or commit; None takes the newest.
    """

    repository: str
    revision: str | None = None


def parse_hub_name(name: str) -> HubFolder | None:
    """Read ORG/NAME, ORG/NAME@REVISION or the same after hf://.

    Args:
        name: What the user gave.

    Returns:
        The repository; None where the name can be none.
    """
    match = _NAME.fullmatch(name.removeprefix(PREFIX))
    if match is None or ".." in match["repository"]:
        return None
    return HubFolder(match["repository"], match["revision"])


def fetch(folder: HubFolder) -> tuple[Path, Path]:
    """Fetch the two files of a model, and nothing else, into the cache of the hub.

    Args:
        folder: The repository.

    Returns:
        The folder with the files, and the folder of the cache that their links stay in.

    Raises:
        HubError: huggingface_hub is not installed, or the hub gives no such repository.
    """
    try:
        from huggingface_hub import snapshot_download
        from huggingface_hub.errors import HfHubHTTPError, HFValidationError, LocalEntryNotFoundError
    except ImportError as error:
        raise HubError(
            f"{folder.repository}: no such folder here; to load from the hub: {install_command('hub')}"
        ) from error
    try:
        path = snapshot_download(
            folder.repository, revision=folder.revision, allow_patterns=[CONFIG_FILE, WEIGHTS_FILE]
        )
    except (HfHubHTTPError, HFValidationError, LocalEntryNotFoundError, OSError) as error:
        reason = " ".join(str(error).split())[:300]
        raise HubError(
            f"{folder.repository}: no such folder here, and the hub does not give it: {reason}"
        ) from error
    # The cache keeps snapshots/COMMIT/FILE as links to blobs/CHECKSUM beside it.
    return Path(path), Path(path).parents[1]
