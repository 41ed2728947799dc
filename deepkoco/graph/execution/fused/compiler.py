"""The system's C++ compiler, and kernels kept by the hash of their source."""

import atexit
import ctypes
import hashlib
import os
import shutil
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path

from deepkoco.graph.execution.executor import NotCompiledError

FLAGS = (
    "-std=c++17",
    "-O2",
    "-fopenmp-simd",
    "-march=native",
    "-ffp-contract=fast",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fPIC",
    "-shared",
    "-Wno-psabi",
)


OF_GCC = ("-fschedule-insns", "-fsched-pressure")
"""Flags that clang does not know."""


class CompilerError(NotCompiledError):
    """There is no C++ compiler, or it refuses a kernel."""


def cache_folder() -> Path:
    """Where kernels are kept: below XDG_CACHE_HOME, by default ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "deepkoco" / "kernels"


def find_compiler() -> str:
    """Path of the C++ compiler: the environment variable CXX, g++ or clang++.

    Raises:
        CompilerError: there is none.
    """
    for name in (os.environ.get("CXX"), "g++", "clang++", "c++"):
        found = name and shutil.which(name)
        if found:
            return found
    raise CompilerError("no C++ compiler (g++ or clang++) on the PATH")


@lru_cache
def flags_of(compiler: str) -> tuple[str, ...]:
    """Flags for a compiler, which may be clang under any name."""
    said = subprocess.run([compiler, "--version"], capture_output=True, text=True, check=False).stdout
    return FLAGS if "clang" in said else (*FLAGS, *OF_GCC)


def load(source: str) -> ctypes.CDLL:
    """Compile C++ into a library, or take the one that was made from the same source before.

    Raises:
        CompilerError: there is no compiler, or it fails.
    """
    compiler = find_compiler()
    words = "\0".join(
        [source, compiler, str(os.stat(compiler).st_mtime_ns), _processor(), *flags_of(compiler)]
    )
    name = f"{hashlib.sha256(words.encode()).hexdigest()[:32]}.so"
    for folder in (cache_folder, _own_folder):
        try:
            path = folder() / name
            if not path.exists():
                _compile(compiler, source, path)
            return ctypes.CDLL(str(path))
        except OSError as error:  # the folder cannot be written, is full, or may hold no programs
            failure = error
    raise CompilerError(f"a compiled kernel cannot be kept or loaded: {failure}")


def _compile(compiler: str, source: str, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        text, library = Path(folder) / "kernel.cpp", Path(folder) / "kernel.so"
        text.write_text(source)
        command = [compiler, *flags_of(compiler), str(text), "-o", str(library)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise CompilerError(f"{compiler} fails:\n{done.stderr[:2000]}")
        os.replace(library, path)


@lru_cache
def _own_folder() -> Path:
    """A folder of this process alone, where that of the user cannot be used."""
    folder = tempfile.mkdtemp(prefix="deepkoco-kernels-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


@lru_cache
def _processor() -> str:
    """What the processor can do: a kernel made for one may not run on another that shares the folder."""
    try:
        with open("/proc/cpuinfo") as file:
            return next((line for line in file if line.startswith(("flags", "Features"))), "")
    except OSError:
        return os.uname().machine + os.uname().version
