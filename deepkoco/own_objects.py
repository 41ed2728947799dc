"""Python objects that users name: `my_robot.py:CartPole`, `package.module:CartPole`, or an entry point."""

from __future__ import annotations

import hashlib
import os
import sys
import sysconfig
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from deepkoco.suggestion import did_you_mean

PREFIX = "deepkoco_own_"  # of the module names of files: they hide no installed module


class OwnObjectError(ValueError):
    """What a user named cannot be imported or found; the message says what to change."""


class OwnObject(NamedTuple):
    """An object with the text that names it."""

    value: Any
    origin: str  # FILE.py:NAME with an absolute path, or MODULE:NAME


def names_object(text: str) -> bool:
    """Whether a text has the form FILE.py, FILE.py:NAME or MODULE:NAME."""
    place, name = split_reference(text)
    if place.endswith(".py"):
        return True
    return bool(name) and all(part.isidentifier() for part in place.split("."))


def split_reference(text: str) -> tuple[str, str]:
    """Split FILE.py:NAME or MODULE:NAME at the last colon; the name is empty where the text has none."""
    place, colon, name = text.rpartition(":")
    if not colon or (not name.isidentifier() and place):
        return text, ""
    return place, name


def find_object(text: str, kind: type, folders: Sequence[Path] = (Path(),)) -> OwnObject:
    """Import what FILE.py:NAME or MODULE:NAME names.

    Importing runs the code of the file: name only files that you trust.

    Args:
        text: The reference. The name may be left out where the file defines one class of the kind.
        kind: Class of which it must be an instance or a subclass.
        folders: Where a relative file is looked for, in this order.

    Raises:
        OwnObjectError: The file, the module or the name is missing, the import fails, or it is of another kind.
    """
    place, name = split_reference(text)
    if place.endswith(".py"):
        path = find_file(place, text, folders)
        module, origin = _import_file(path, text), str(path)
    else:
        module, origin = import_named(place, text), place
    value = _attribute(module, name, kind, text)
    is_class = isinstance(value, type) and issubclass(value, kind)
    if not (is_class or isinstance(value, kind)):
        raise OwnObjectError(
            f'"{text}": {name} is no {kind.__name__}: derive the class from deepkoco.{kind.__name__}'
        )
    return OwnObject(value, f"{origin}:{name or value.__name__}")


def find_file(place: str, text: str, folders: Sequence[Path]) -> Path:
    """Find a file that a text names, in the first folder that has it.

    Returns:
        Its absolute path.

    Raises:
        OwnObjectError: No folder has it.
    """
    for folder in folders:
        path = folder / Path(place).expanduser()
        if path.is_file():
            return Path(os.path.abspath(path))
    searched = " nor in ".join(dict.fromkeys(str(folder.absolute()) for folder in folders))
    where = "" if Path(place).is_absolute() else f", {'neither ' if ' nor ' in searched else ''}in {searched}"
    raise OwnObjectError(f'"{text}": there is no file {place}{where}; give its path, or put the file there')


def import_named(module: str, text: str) -> ModuleType:
    """Import a module, from the current folder too.

    Raises:
        OwnObjectError: It is missing, or its import fails.
    """
    here = os.getcwd()
    # As with `python my_robot.py`; an installed command has the folder of the command there instead.
    if not {"", here} & set(sys.path):
        sys.path.insert(0, here)
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise OwnObjectError(f'"{text}": {module} needs a module that is missing: {error}') from error
        raise OwnObjectError(
            f'"{text}": there is no module {error.name}, neither in {here} nor installed'
        ) from error
    except Exception as error:
        raise OwnObjectError(f'"{text}": importing {module} failed: {in_words(error)}') from error


def in_words(error: BaseException) -> str:
    """Kind and text of an error on one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def entry_point_names(group: str) -> tuple[str, ...]:
    """Names that installed packages declare in a group of entry points."""
    return tuple(sorted({point.name for point in entry_points(group=group)}))


def entry_point(group: str, name: str) -> Any:
    """Load what an installed package declares under a name.

    Raises:
        OwnObjectError: Its import fails.
        KeyError: No package declares the name.
    """
    for point in entry_points(group=group, name=name):
        try:
            return point.load()
        except Exception as error:
            raise OwnObjectError(
                f'"{name}": the entry point {point.value} of {group} cannot be loaded: {in_words(error)}'
            ) from error
    raise KeyError(name)


def origin_of_class(kind: type) -> str | None:
    """The text by which `find_object` finds a class again; None for one that has no place of its own."""
    if not kind.__qualname__.isidentifier():  # made in a function or a class
        return None
    module = sys.modules.get(kind.__module__)
    file = getattr(module, "__file__", None)
    if (
        kind.__module__ == "__main__"
        or kind.__module__.startswith(PREFIX)
        or _lies_alone(kind.__module__, file)
    ):
        return f"{os.path.abspath(file)}:{kind.__qualname__}" if file and file.endswith(".py") else None
    return f"{kind.__module__}:{kind.__qualname__}"


def _lies_alone(module: str, file: str | None) -> bool:
    """Whether a module is a file of the user's, which is found from its folder only, and not installed."""
    if "." in module or not file:
        return False
    installed = [Path(path).resolve() for path in sysconfig.get_paths().values()]
    return not any(place in Path(file).resolve().parents for place in installed)


def _import_file(path: Path, text: str) -> ModuleType:
    main = sys.modules.get("__main__")
    if (own := getattr(main, "__file__", None)) and os.path.abspath(own) == str(path):
        return main  # type: ignore[return-value]  # the running script names its own class: do not run it again
    stat = path.stat()
    name = f"{PREFIX}{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    stamp = (stat.st_mtime_ns, stat.st_size)
    known = sys.modules.get(name)
    if known is not None and getattr(known, "_deepkoco_stamp", None) == stamp:
        return known
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))  # modules beside it, behind all that is installed
    spec = spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException as error:
        sys.modules.pop(name)
        if not isinstance(error, Exception | SystemExit):
            raise
        line = _line_in(error, path)
        raise OwnObjectError(f'"{text}": importing {path}{line} failed: {in_words(error)}') from error
    module._deepkoco_stamp = stamp  # type: ignore[attr-defined]
    return module


def _line_in(error: BaseException, path: Path) -> str:
    """The last line of the file that an error passed through, as ", line N,"."""
    found, step = "", error.__traceback__
    while step is not None:
        if step.tb_frame.f_code.co_filename == str(path):
            found = f", line {step.tb_lineno},"
        step = step.tb_next
    return found


def _attribute(module: ModuleType, name: str, kind: type, text: str) -> Any:
    defined = [
        key
        for key, value in vars(module).items()
        if isinstance(value, type) and issubclass(value, kind) and value.__module__ == module.__name__
    ]
    place = getattr(module, "__file__", None) or module.__name__
    if name:
        if not hasattr(module, name):
            hint = did_you_mean(name, defined) or (f"; it defines {', '.join(defined)}" if defined else "")
            raise OwnObjectError(f'"{text}": {place} has no {name}{hint}')
        return getattr(module, name)
    if len(defined) != 1:
        what = f"defines {', '.join(defined)}" if defined else f"defines no {kind.__name__}"
        raise OwnObjectError(
            f'"{text}": {place} {what}; give the class behind a colon, as in my_robot.py:CartPole'
        )
    return getattr(module, defined[0])
