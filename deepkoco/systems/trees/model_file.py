"""Reading MJCF and URDF files: the compiled MuJoCo model, also where files of shapes or pictures are missing."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from deepkoco.systems.trees.held_joints import Follower, chosen_joints, followers, hold_joints
from deepkoco.systems.trees.inertias import give_inertia, mend_inertias
from deepkoco.systems.trees.messages import in_one_sentence, massless_body, missing_file
from deepkoco.systems.trees.mujoco_library import mujoco_library, warnings_of_mujoco
from deepkoco.systems.trees.tree import TreeError

MOST_FILES = 1000  # missing files of one model


def read_model(
    path: str | Path, held: Mapping[str, float] | None = None, kept: Collection[str] = ()
) -> tuple[Any, tuple[str, ...]]:
    """Compile an MJCF or URDF file.

    What only shows (meshes of bodies whose inertia is given, textures, height fields) is left out where its file is
    missing. Joints that follow others are held, inertias that no body of matter has become the nearest possible ones,
    and frames between two joints get a small mass.

    Args:
        path: File; other files that it includes are found beside it.
        held: Joints that are held; see :func:`.hold_joints`.
        kept: Joints that follow others and are not held.

    Returns:
        The `mujoco.MjModel`, and sentences on what was left out of it or changed.

    Raises:
        TreeError: The file is missing or is not valid; the message names the element and the way out.
    """
    model, _, notes = _compiled(Path(path), held or {}, kept)
    return model, notes


def read_followers(path: str | Path, held: Mapping[str, float] | None = None) -> tuple[Follower, ...]:
    """Joints of a file that follow others along a straight line, and whose leader is neither held nor follows another.

    Raises:
        TreeError: The file is missing or is not valid, or ``held`` names a joint that it does not have.
    """
    path = Path(path)
    _compiled(path, held or {})
    spec = _spec(path)
    chosen = chosen_joints(spec, held or {})
    found = [own for own in followers(spec, chosen) if own.ratio]
    led = {own.name for own in found}
    joints = {joint.name for joint in spec.joints}
    return tuple(own for own in found if own.leader in joints and own.leader not in led | set(chosen))


def read_spec(path: str | Path, held: Mapping[str, float] | None = None) -> tuple[Any, tuple[str, ...]]:
    """As :func:`read_model`, but the specification (`mujoco.MjSpec`) before it is compiled."""
    path = Path(path)
    _, lacks, notes = _compiled(path, held or {})
    with warnings_of_mujoco():  # the notes have them
        return _prepared(path, lacks, held or {})[0], notes


@dataclass
class _Lacks:
    """What a model file does without, as its compilation shows."""

    files: list[str] = field(default_factory=list)
    masses: list[str] = field(default_factory=list)
    """Bodies that move and have none."""


def _compiled(
    path: Path, held: Mapping[str, float], kept: Collection[str] = ()
) -> tuple[Any, _Lacks, tuple[str, ...]]:
    """The model, what its file lacks, and sentences on what was left out or changed."""
    if not path.is_file():
        raise TreeError(f"{path}: there is no such file")
    try:
        ElementTree.parse(path)
    except ElementTree.ParseError as error:
        raise TreeError(f"{path}: is no valid XML: {error}") from None
    with warnings_of_mujoco() as told:
        model, lacks, notes = _tried(path, held, kept)
    return model, lacks, (*notes, *(f"MuJoCo says: {each}" for each in dict.fromkeys(told)))


def _tried(
    path: Path, held: Mapping[str, float], kept: Collection[str]
) -> tuple[Any, _Lacks, tuple[str, ...]]:
    """The model as soon as it compiles without what its file lacks."""
    lacks = _Lacks(_not_there(_spec(path), path))
    for _ in range(MOST_FILES):
        # A specification that failed to compile may have changed: each try starts from the file.
        spec, notes = _prepared(path, lacks, held, kept)
        _refuse_muscles(spec, path)
        try:
            return spec.compile(), lacks, notes
        except (ValueError, RuntimeError) as error:
            file, body = missing_file(str(error)), massless_body(str(error))
            if file is not None and file not in lacks.files:
                lacks.files.append(file)
            elif body is not None and body not in lacks.masses and give_inertia(_spec(path), body):
                lacks.masses.append(body)
            else:
                raise TreeError(f"{path}: {in_one_sentence(str(error))}") from None
    raise TreeError(f"{path}: more than {MOST_FILES} files are missing")


def _prepared(
    path: Path, lacks: _Lacks, held: Mapping[str, float], kept: Collection[str] = ()
) -> tuple[Any, tuple[str, ...]]:
    """The specification without what it lacks, with its joints held and its inertias mended, and sentences on these."""
    spec = _spec(path)
    notes = [*_left_out(spec, path, lacks.files)]
    try:
        notes += hold_joints(spec, held, kept)
    except TreeError as error:
        raise TreeError(f"{path}: {error}") from None
    notes += mend_inertias(spec)
    for body in lacks.masses:
        give_inertia(spec, body)
    return spec, tuple(notes)


def _spec(path: Path) -> Any:
    try:
        return mujoco_library().MjSpec.from_file(str(path))
    except (ValueError, RuntimeError) as error:
        raise TreeError(f"{path}: {in_one_sentence(str(error))}") from None


def is_urdf(path: str | Path) -> bool:
    """Whether the file describes a URDF robot, whatever its ending."""
    for _, element in ElementTree.iterparse(str(path), events=("start",)):
        return element.tag == "robot"
    return False


def _not_there(spec: Any, path: Path) -> list[str]:
    """Files of meshes that are neither where the model says nor beside it."""
    folders = (path.parent / (spec.meshdir or ""), path.parent)
    found = []
    for mesh in spec.meshes:
        file = mesh.file
        if not file or file in spec.assets or "://" in file:
            continue
        if not any((folder / name).is_file() for folder in folders for name in (file, Path(file).name)):
            found.append(file)
    return found


def _left_out(spec: Any, path: Path, missing: list[str]) -> tuple[str, ...]:
    """Take assets whose files are missing out of a model, and what uses them."""
    if not missing:
        return ()
    meshes = {_name(m): m.file for m in spec.meshes if _same(m.file, missing)}
    fields = {_name(h): h.file for h in spec.hfields if _same(h.file, missing)}
    removed = 0
    for body in spec.bodies:
        for geom in list(body.geoms):
            file = meshes.get(geom.meshname) or fields.get(geom.hfieldname)
            if file is None:
                continue
            if geom.meshname and _decides_inertia(spec, body, geom):
                raise TreeError(
                    f'{path}: the mesh file "{file}" is missing, and the body "{body.name}" has no inertial: '
                    "put the file there, or give the body an <inertial>"
                )
            spec.delete(geom)
            removed += 1
    for asset in (*spec.meshes, *spec.hfields):
        if _same(asset.file, missing):
            spec.delete(asset)
    pictures = {_name(t) for t in spec.textures if _same(t.file, missing)}
    for material in spec.materials:
        if any(name in pictures for name in material.textures):
            material.textures = ["" if name in pictures else name for name in material.textures]
    for texture in list(spec.textures):
        if _same(texture.file, missing):
            spec.delete(texture)
    files = "1 file is missing" if len(missing) == 1 else f"{len(missing)} files are missing"
    shapes = "1 shape" if removed == 1 else f"{removed} shapes"
    return (f"{files} ({Path(missing[0]).name}{', ...' if len(missing) > 1 else ''}); {shapes} left out",)


def _same(file: str, missing: list[str]) -> bool:
    """Whether an asset's file is one of those that are missing, which messages may name with their folder."""
    return bool(file) and any(file == other or Path(file).name == Path(other).name for other in missing)


def _name(asset: Any) -> str:
    return asset.name or Path(asset.file).stem


def _decides_inertia(spec: Any, body: Any, geom: Any) -> bool:
    """Whether the mass of a moving body comes from a geom."""
    weightless = (not math.isnan(geom.mass) and geom.mass == 0.0) or geom.density == 0.0
    given = bool(body.explicitinertial) and int(spec.compiler.inertiafromgeom) != 1
    return not weightless and not given and _moves(body)


def _moves(body: Any) -> bool:
    while body is not None and body.name != "world":
        if list(body.joints):
            return True
        body = body.parent
    return False


def _refuse_muscles(spec: Any, path: Path) -> None:
    # Compiling a muscle simulates it, which can fail with a message that names no element.
    for actuator in spec.actuators:
        if "MUSCLE" in str(actuator.gaintype) or "MUSCLE" in str(actuator.dyntype):
            raise TreeError(
                f'{path}: the actuator "{actuator.name}" is a muscle; replace it by a motor or a position actuator, or '
                "use the MuJoCo engine"
            )
