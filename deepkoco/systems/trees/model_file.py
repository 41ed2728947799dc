"""Reading MJCF and URDF files: the compiled MuJoCo model, also where mesh files are missing."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from deepkoco.systems.trees.tree import TreeError

if TYPE_CHECKING:
    import mujoco

ENDINGS = (".xml", ".mjcf", ".urdf")


def read_model(path: str | Path) -> tuple[mujoco.MjModel, tuple[str, ...]]:
    """Compile an MJCF or URDF file; as :func:`read_spec`.

    Returns:
        The model, and sentences on what was left out of it.
    """
    spec, notes = read_spec(path)
    try:
        return spec.compile(), notes
    except (ValueError, RuntimeError) as error:
        raise TreeError(_reading(Path(path), error)) from None


def read_spec(path: str | Path) -> tuple[Any, tuple[str, ...]]:
    """Read an MJCF or URDF file without compiling it.

    Geoms whose mesh file is missing are left out where the inertia of the bodies is given.

    Args:
        path: File; other files that it includes are found beside it.

    Returns:
        The specification (``mujoco.MjSpec``), and sentences on what was left out of it.

    Raises:
        TreeError: The file is missing or is not valid; the message names the element and the way out.
    """
    import mujoco

    path = Path(path)
    if not path.is_file():
        raise TreeError(f"{path}: there is no such file")
    notes: tuple[str, ...] = ()
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, RuntimeError) as error:
        raise TreeError(_reading(path, error)) from None
    missing = _missing_meshes(spec, path)
    if missing:
        notes = _without_meshes(spec, path, missing)
    return spec, notes


def is_urdf(path: str | Path) -> bool:
    """Whether the file describes a URDF robot, whatever its ending."""
    try:
        for _, element in ElementTree.iterparse(str(path), events=("start",)):
            return element.tag == "robot"
    except (ElementTree.ParseError, OSError):
        pass
    return False


def _missing_meshes(spec: Any, path: Path) -> dict[str, str]:
    """Mesh -> its file, for files that are not there."""
    folder = Path(spec.modelfiledir or path.parent) / (spec.meshdir or spec.compiler.meshdir or "")
    found = {}
    for mesh in spec.meshes:
        file = mesh.file
        if not file or file in spec.assets:
            continue
        name = Path(file).name if spec.strippath or spec.compiler.strippath else file
        places = (folder / name, path.parent / name)
        if not any(place.is_file() for place in places):
            found[mesh.name or Path(file).stem] = file
    return found


def _without_meshes(spec: Any, path: Path, missing: dict[str, str]) -> tuple[str, ...]:
    removed = 0
    needed: list[tuple[str, str]] = []
    bodies = list(spec.bodies)
    for body in bodies:
        for geom in list(body.geoms):
            if geom.meshname in missing:
                needed += [(body.name or "a body", missing[geom.meshname])] if not _has_inertia(body) else []
                spec.delete(geom)
                removed += 1
    moving = {name for name, _ in needed}
    for body in bodies:
        if (body.name or "a body") in moving and _moves(body):
            file = next(file for name, file in needed if name == (body.name or "a body"))
            raise TreeError(
                f'{path}: the mesh file "{file}" is missing, and the body "{body.name}" has no inertial: '
                "put the file there, or give the body an <inertial>"
            )
    for mesh in list(spec.meshes):
        if (mesh.name or Path(mesh.file).stem) in missing:
            spec.delete(mesh)
    return (
        f"{len(missing)} mesh files are missing; {removed} geoms with them are left out, the inertias are as given",
    )


def _has_inertia(body: Any) -> bool:
    return bool(body.explicitinertial)


def _moves(body: Any) -> bool:
    at = body
    while at is not None and at.name != "world":
        if list(at.joints):
            return True
        at = at.parent
    return False


def _reading(path: Path, error: Exception) -> str:
    """One sentence from MuJoCo's message, which may have several lines."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    text = re.sub(r"^(XML Error|Error|XML parse error)\s*:?\s*", "", "; ".join(lines))
    return f"{path}: MuJoCo cannot read it: {text.rstrip('.')}"
