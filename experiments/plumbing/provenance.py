"""Where a result comes from: commit, versions and hardware, for the files under results/."""

from __future__ import annotations

import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("deepkoco", "torch", "numpy", "scipy", "gymnasium", "daqp", "osqp", "qpsolvers")


def provenance() -> dict[str, str]:
    """Commit (with "+" where the working tree differs), Python, package versions and processor."""
    here = Path(__file__).parent
    found = {"commit": _git(here, "rev-parse", "--short=12", "HEAD") or "unknown"}
    if _git(here, "status", "--porcelain", "--untracked-files=no"):
        found["commit"] += "+"
    found["python"] = platform.python_version()
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    found["processor"] = _processor()
    found["cores"] = str(os.cpu_count())
    return found


def _git(folder: Path, *arguments: str) -> str:
    try:
        run = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return ""
    return run.stdout.strip() if run.returncode == 0 else ""


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def as_markdown() -> str:
    """The provenance as a table for a README."""
    rows = [f"| {name} | {value} |" for name, value in provenance().items()]
    return "\n".join(["| | |", "|---|---|", *rows])


if __name__ == "__main__":
    print(as_markdown())
