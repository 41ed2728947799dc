"""The stand-in for a full disk of other tests."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.full_disk import largest_file


def test_a_module_imported_on_a_full_disk_is_imported_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
    (tmp_path / "large.py").write_text("\n".join(f"x{i} = {i}" for i in range(300)))
    command = [sys.executable, "-c", "import large; print(large.x299)"]
    for _ in range(2):
        with largest_file(300):
            limited = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
        free = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
        assert limited.stdout == free.stdout == "299\n"
