"""Write gains, limits, lags and delays of a robot into a MuJoCo specification."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch

from deepkoco.systems.trees.mujoco_library import mujoco_library
from deepkoco.systems.trees.names import Names
from deepkoco.systems.trees.parameters import actuator_law
from deepkoco.systems.trees.tree import Actuator, Tree
from deepkoco.systems.trees.tree_system import TreeSystem
from deepkoco.systems.trees.write_bodies import FITTED, Note, Values, same


class ActuatorWriter:
    """Edits of the actuators of one specification.

    What several effects of one command make together is gathered first: the command u becomes scale * u + offset, then
    is cut to +-limit, filtered, and delayed.

    Args:
        robot: The robot that was read from the specification.
        spec: MuJoCo's specification, changed in place.
        model: The specification as it was, compiled.
        file: The robot as the file has it, without settings beside it.
        values: Every parameter of the robot and of its effects.
        note: Takes element, attribute, value before and after, unit and reason of each change.
    """

    def __init__(
        self, robot: TreeSystem, spec: Any, model: Any, file: Tree, values: Values, note: Note
    ) -> None:
        self.robot, self.spec, self.file, self.values, self.note = robot, spec, file, values, note
        named = dict(zip(Names(model).actuators, sorted(spec.actuators, key=lambda a: a.id), strict=True))
        # The tree has another order than the file where several actuators drive one joint.
        self.actuators = [named[a.name] for a in robot.tree.actuators if a.name in named]
        count = len(robot.tree.actuators)
        self.scale, self.offset = [1.0] * count, [0.0] * count
        self.limit, self.lag, self.delay = [math.inf] * count, [0.0] * count, [0.0] * count

    def add_motors(self) -> None:
        """Give each joint of a file without actuators the one that the robot has there."""
        joints = sorted(self.spec.joints, key=lambda j: j.id)
        for actuator in self.robot.tree.actuators:
            joint = joints[actuator.joint]
            own = self.spec.add_actuator(name=actuator.name, target=joint.name)
            own.set_to_motor()
            own.trntype = mujoco_library().mjtTrn.mjTRN_JOINT
            if any(actuator.bias):
                own.biastype = mujoco_library().mjtBias.mjBIAS_AFFINE
            if math.isfinite(actuator.low) and math.isfinite(actuator.high):
                own.ctrlrange, own.ctrllimited = [actuator.low, actuator.high], True
            if math.isfinite(actuator.force_low) and math.isfinite(actuator.force_high):
                own.forcerange, own.forcelimited = [actuator.force_low, actuator.force_high], True
            self.actuators.append(own)

    def write(self) -> None:
        """Write every value that differs from the file's, but what effects change of lag and delay."""
        tensors = {n: torch.tensor(v, dtype=torch.float64) for n, v in self.values.items()}
        for number, actuator in enumerate(self.robot.tree.actuators):
            gain, bias, low, high = actuator_law(actuator, tensors)
            own, element = self.actuators[number], f'actuator "{actuator.name}"'
            file = self._in_file(actuator)
            for label, given, now in (("gainprm", file.gain, gain), ("biasprm", file.bias, bias)):
                values = np.array(getattr(own, label), dtype=float)
                for i, (before, after) in enumerate(zip(given, now, strict=True)):
                    if not same(before, float(after)):
                        self.note(element, f"{label} {i + 1}", before, float(after), "1", FITTED)
                        values[i] = float(after)
                setattr(own, label, values)
            forces = [float(low), float(high)]
            for end, before, after in zip(
                ("low", "high"), (file.force_low, file.force_high), forces, strict=True
            ):
                if not same(before, after):
                    self.note(element, f"forcerange {end}", before, after, self._force_unit(file), FITTED)
                    own.forcerange, own.forcelimited = forces, True
            self.lag[number] = self.values.get(f"time_constant({actuator.name})", actuator.time_constant)
            self.delay[number] = self.values.get(f"delay({actuator.name})", actuator.delay)

    def add_affine(self, name: str, index: int, own: Values) -> None:
        """Multiply a command by a factor, or add an effort to it."""
        # In the order in which the effects act: a gain before a bias.
        if "factor" in own:
            self.scale[index] *= own["factor"]
            self.offset[index] *= own["factor"]
        else:
            self.offset[index] += own["effort"]
        now = own.get("factor", own.get("effort", 0.0))
        before, unit = (1.0, "1") if "factor" in own else (0.0, self.robot.commands[index].unit)
        self.note(
            f'actuator "{self.robot.commands[index].name}"', name.split("(")[0], before, now, unit, name
        )

    def finish(self) -> None:
        """Write what several effects of one command make together."""
        m = mujoco_library()
        for i, actuator in enumerate(self.robot.tree.actuators):
            own, element = self.actuators[i], f'actuator "{actuator.name}"'
            scale, offset, limit = self.scale[i], self.offset[i], self.limit[i]
            gain, bias = np.array(own.gainprm, dtype=float), np.array(own.biasprm, dtype=float)
            if (scale, offset) != (1.0, 0.0):
                # gain * (scale u + offset) + bias, with a gain that may depend on length and velocity.
                bias[:3] += gain[:3] * offset
                gain[:3] *= scale
                own.gainprm, own.biasprm = gain, bias
                if bias[:3].any():
                    own.biastype = m.mjtBias.mjBIAS_AFFINE
            if math.isfinite(limit) and scale != 0.0:
                ends = sorted(((-limit - offset) / scale, (limit - offset) / scale))
                low, high = max(actuator.low, ends[0]), min(actuator.high, ends[1])
                if low > high:
                    low = high = min(max(low, actuator.low), actuator.high)
                own.ctrlrange, own.ctrllimited = [low, high], True
                self.note(
                    element, "ctrlrange high", actuator.high, high, self.robot.commands[i].unit, "saturation"
                )
            if not same(self.lag[i], actuator.time_constant):
                values = np.array(own.dynprm, dtype=float)
                values[0] = self.lag[i]
                own.dynprm = values
                own.dyntype = m.mjtDyn.mjDYN_FILTEREXACT if self.lag[i] > 0.0 else m.mjtDyn.mjDYN_NONE
                self.note(element, "dynprm 1", actuator.time_constant, self.lag[i], "s", "first-order lag")
            if not same(self.delay[i], actuator.delay):
                step = float(self.spec.option.timestep)
                # Linear interpolation, as a delay need not be a multiple of the time step. It lets a jump of the
                # command begin one step early, so its middle is half a step early.
                own.delay, own.interp = self.delay[i] + 0.5 * step, 1
                own.nsample = max(int(own.nsample), math.ceil(own.delay / step) + 2)
                reason = (
                    "delay of the command (the file has half a time step more, for MuJoCo's interpolation)"
                )
                self.note(element, "delay", actuator.delay, self.delay[i], "s", reason)

    def _force_unit(self, actuator: Actuator) -> str:
        return "N" if self.robot.tree.joints[actuator.joint].slides else "N m"

    def _in_file(self, actuator: Actuator) -> Actuator:
        return next(own for own in self.file.actuators if own.name == actuator.name)
