"""Names of the elements of a model, as parameters and channels can bear them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from deepkoco.systems.named_joints import UNREADABLE
from deepkoco.systems.trees.mujoco_library import Model, mujoco_library


class Names:
    """Names of joints, bodies, actuators and sites; what has none gets one, and signs that names lack are replaced."""

    def __init__(self, model: Model) -> None:
        mujoco = mujoco_library()
        kinds = mujoco.mjtObj
        self.notes: list[str] = []

        def given(kind: Any, i: int) -> str:
            return mujoco.mj_id2name(model, kind, i) or ""

        bodies = [given(kinds.mjOBJ_BODY, b) or f"body {b}" for b in range(model.nbody)]
        self.bodies = self._readable(bodies, "body")
        joints = []
        for j in range(model.njnt):
            body = self.bodies[model.jnt_bodyid[j]]
            alone = model.body_jntnum[model.jnt_bodyid[j]] == 1
            number = j - model.body_jntadr[model.jnt_bodyid[j]] + 1
            joints.append(given(kinds.mjOBJ_JOINT, j) or (body if alone else f"{body} {number}"))
        self.joints = self._readable(joints, "joint")
        actuators = []
        for a in range(model.nu):
            driven = model.actuator_trnid[a, 0]
            actuators.append(given(kinds.mjOBJ_ACTUATOR, a) or self._free(self.joints[driven], actuators))
        self.actuators = self._readable(actuators, "actuator")
        sites = [given(kinds.mjOBJ_SITE, s) or f"site {s}" for s in range(model.nsite)]
        self.sites = self._readable(sites, "site")
        self.tendons = [given(kinds.mjOBJ_TENDON, t) or f"tendon {t}" for t in range(model.ntendon)]

    @staticmethod
    def _free(name: str, taken: Sequence[str]) -> str:
        number, free = 2, name
        while free in taken:
            free, number = f"{name} {number}", number + 1
        return free

    def _readable(self, names: list[str], kind: str) -> list[str]:
        result: list[str] = []
        for name in names:
            plain = "".join("_" if sign in UNREADABLE else sign for sign in name)
            unique = self._free(plain, result)
            if unique != name:
                self.notes.append(f'the {kind} "{name}" is called "{unique}" here')
            result.append(unique)
        return result
