"""Least squares on all listed parameters with `mujoco.sysid`, the toolbox of MuJoCo.

It replays windows from measured start states, as the toolbox does: start states are not fitted, and there are bounds
but no priors. The parameters are all that the model as given lists. A delay is none of them. A system that is no MJCF
goes to scipy's least squares with the same parameters.
"""

from __future__ import annotations

import contextlib
import io
import logging
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from deepkoco.fit.data.windows import Windows, cut_windows, moving
from deepkoco.fit.fit import FitProblem
from deepkoco.logs.recording import Recording
from deepkoco.systems import ExtendedSystem, Parameter, System
from deepkoco.systems.trees.mujoco_library import mujoco_library
from experiments.studies.diagnosis.hidden_cause.entrants.as_given import simulation_of
from experiments.studies.diagnosis.hidden_cause.entrants.naming import first_name, usual_scale
from experiments.studies.diagnosis.hidden_cause.questions import Answer, Handed

mujoco = mujoco_library()
sysid = import_module("mujoco.sysid")  # works with the extra `rivals`
MOST_WINDOWS = 16
ITERATIONS = 30
NORMAL = 1.96
NULL = 1e-8  # curvature in usual scales, relative to the largest, below which the log shows nothing


class Fitted(NamedTuple):
    """Values of the listed parameters, and the curvature (P, P) of the cost at them in residual variances."""

    values: dict[str, float]
    curvature: np.ndarray


class MujocoSysid:
    """`mujoco.sysid.optimize`; names the largest change in its usual scale that is beyond its interval (`naming`).

    Where the log shows only a ratio of parameters, the fit may slide along it. Such a part of the change is taken off
    first, and intervals leave it out: else each of them would be infinite, and nothing could be named.
    """

    name = "mujoco_sysid"

    def __init__(self) -> None:
        if not hasattr(sysid, "optimize"):
            raise ImportError("mujoco.sysid lacks the packages that it needs")

    def answer(self, handed: Handed) -> Answer:
        """Fit all listed parameters to the log, and to the healthy logs to compare with."""
        system = handed.system
        found = _fit(system, handed.xml, handed.log, handed.window)
        before = {n: system.parameter(n).value for n in found.values}
        other = None
        if handed.healthy:
            other = _fit(system, handed.xml, handed.healthy, handed.window)
            before = other.values
        name = named(system, before, found, other)
        how = "mujoco.sysid" if handed.xml else "scipy"
        return Answer(name, (name,), simulation_of(ExtendedSystem(system, ()), found.values), how)


def named(system: System, before: dict[str, float], found: Fitted, healthy: Fitted | None) -> str:
    """Return the cause that the largest change stands for, see `MujocoSysid`.

    Args:
        system: The model as given.
        before: Values to compare with.
        found: The fit to the log.
        healthy: The fit to the healthy logs; None where there are none.
    """
    names = list(found.values)
    listed = {n: system.parameter(n) for n in names}
    scale = np.array([usual_scale(system, n, before[n], listed[n].prior_sd) for n in names])
    change = np.array([found.values[n] - before[n] for n in names]) / scale
    half = np.zeros(len(names))
    for fitted in (found, healthy):
        if fitted is not None:
            size, along = np.linalg.eigh(fitted.curvature * scale[:, None] * scale[None])
            seen = size > NULL * size.max()
            change = along[:, seen] @ (along[:, seen].T @ change)
            half += NORMAL * np.sqrt(((along[:, seen] ** 2) / size[seen]).sum(1))
    after = {n: before[n] + d * s for n, d, s in zip(names, change, scale, strict=True)}
    interval = dict(zip(names, half * scale, strict=True))
    return first_name(system, before, after, {n: listed[n].prior_sd for n in names}, interval)


def _fit(system: System, xml: str | None, logs: Sequence[Recording], window: float) -> Fitted:
    windows = cut_windows(logs, system, window)
    windows = windows.take(moving(windows)) if moving(windows).any() else windows
    if len(windows) > MOST_WINDOWS:
        windows = windows.take(np.unique(np.linspace(0, len(windows) - 1, MOST_WINDOWS).astype(int)))
    return with_scipy(system, windows) if xml is None else with_sysid(system, xml, windows)


def with_sysid(system: System, xml: str, windows: Windows) -> Fitted:
    """Fit an MJCF to windows.

    Args:
        system: The model as a system, which lists the parameters.
        xml: The same as MJCF text.
        windows: Of the logs.
    """
    spec = mujoco.MjSpec.from_string(xml)
    model = spec.compile()
    shown = [c for c in range(windows.value.shape[1]) if bool(windows.valid[:, c].any())]
    joints = [model.joint(j).name for j in range(model.njnt)]
    for c in shown:
        kind = mujoco.mjtSensor.mjSENS_JOINTPOS if c < len(joints) else mujoco.mjtSensor.mjSENS_JOINTVEL
        spec.add_sensor(
            name=system.measurements[c].name,
            type=kind,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=joints[c % len(joints)],
        )
    model = spec.compile()
    parameters = sysid.ParameterDict()
    for p in system.parameters:
        parameters.add(
            sysid.Parameter(
                p.name,
                nominal=p.value,
                min_value=_low(p),
                max_value=_high(p),
                modifier=_modifier(p.name),
            )
        )
    starts, controls, readings = [], [], []
    for w in range(len(windows)):
        starts.append(
            sysid.create_initial_state(
                model, windows.state[w, : model.nq].numpy(), windows.state[w, model.nq :].numpy(), None
            )
        )
        # The toolbox interpolates commands linearly; given at its own step they hold as they did.
        grid = np.arange(round(windows.length / model.opt.timestep) + 1) * model.opt.timestep
        series = windows.commands[windows.log[w]]
        row = np.searchsorted(series.t, windows.t0[w] + grid + 1e-9, side="right") - 1
        controls.append(sysid.TimeSeries(grid, series.value[np.maximum(row, 0)].reshape(len(grid), -1)))
        inside = windows.valid[w, shown].all(0).numpy()
        stamps = windows.t[w, shown[0]].numpy()[inside]
        later = stamps > 2.0 * model.opt.timestep
        values = windows.value[w, shown].numpy()[:, inside].T
        readings.append(sysid.TimeSeries.from_names(stamps[later], values[later], model))
    names = [f"window {w}" for w in range(len(windows))]
    sequences = sysid.ModelSequences("unit", spec, names, starts, controls, readings)
    residual = sysid.build_residual_fn(
        models_sequences=[sequences], build_model=_builder(system), n_threads=1
    )
    level = logging.getLogger("absl").level
    logging.getLogger("absl").setLevel(logging.ERROR)
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # it prints every iteration
            fitted, result = sysid.optimize(parameters, residual, verbose=False, max_iters=ITERATIONS)
        left = np.concatenate([np.ravel(x) for x in residual(fitted.as_vector(), fitted)[0]])
    finally:
        logging.getLogger("absl").setLevel(level)
    found = dict(zip([p.name for p in system.parameters], fitted.as_vector().tolist(), strict=True))
    return Fitted(found, _curvature(result.jac, left))


def with_scipy(system: System, windows: Windows) -> Fitted:
    """Fit the listed parameters of any system to windows, in the package's own simulation."""
    extended = ExtendedSystem(system, ())
    problem, listed = FitProblem(extended, windows), list(system.parameters)
    columns = [problem.names.index(p.name) for p in listed]
    given = np.array([{p.name: p.value for p in listed}.get(n, 0.0) for n in problem.names])
    given[problem.names.index("event.duration")] = 0.1
    scale = np.array([p.prior_sd for p in listed])
    low, high = np.array([_low(p) for p in listed]), np.array([_high(p) for p in listed])
    start = np.clip(np.array([p.value for p in listed]), low, high)

    def residual(x: np.ndarray) -> np.ndarray:
        theta = given[None].copy()
        theta[0, columns] = np.clip(x * scale, low, high)
        shown = problem.predict(theta, windows.state[None], problem.nuisances.none()[None])[0]
        return np.nan_to_num(((windows.value - shown) * problem.weight).numpy().ravel(), nan=1e6)

    bounds = (low / scale - 1e-9, high / scale + 1e-9)
    result = least_squares(residual, start / scale, bounds=bounds, max_nfev=ITERATIONS)
    found = dict(zip([p.name for p in listed], np.clip(result.x * scale, low, high).tolist(), strict=True))
    return Fitted(found, _curvature(result.jac / scale, result.fun))


def _curvature(jacobian: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Curvature in variances of the residuals that are left."""
    noise = float(residual @ residual) / max(len(residual) - jacobian.shape[1], 1)
    return jacobian.T @ jacobian / max(noise, 1e-300)


def _low(p: Parameter) -> float:
    return p.low if np.isfinite(p.low) else p.value - 20.0 * p.prior_sd


def _high(p: Parameter) -> float:
    return min(p.high, p.value + 20.0 * p.prior_sd) if p.value + 20.0 * p.prior_sd > _low(p) else p.high


def _builder(system: System) -> Callable[[Any, Any], Any]:
    """Compile a spec with parameters; axes of inertia that the motion does not show keep it a possible body."""
    listed: dict[str, list[int]] = {}
    for p in system.parameters:
        if p.name.startswith("inertia_"):
            listed.setdefault(p.name.partition("(")[2].rstrip(")"), []).append("xyz".index(p.name[8]))

    def build(parameters: Any, spec: Any) -> Any:
        sysid.apply_param_modifiers_spec(parameters, spec)
        for name, axes in listed.items():
            body = spec.body(name)
            for axis in {0, 1, 2} - set(axes):
                body.inertia[axis] = max(body.inertia[k] for k in axes)
        return spec.compile()

    return build


def _modifier(name: str) -> Callable[[Any, Any], None]:
    """Set a listed parameter in an `MjSpec`."""
    kind, _, rest = name.partition("(")
    place = rest.rstrip(")")

    def change(spec: Any, parameter: Any) -> None:
        value = float(np.ravel(parameter.value)[0])
        if kind == "mass":
            spec.body(place).mass = value
        elif kind.startswith("com_"):
            spec.body(place).ipos["xyz".index(kind[-1])] = value
        elif kind.startswith("inertia_"):
            spec.body(place).inertia["xyz".index(kind[-1])] = value
        elif kind in ("damping", "stiffness"):
            getattr(spec.joint(place), kind)[0] = value
        elif kind in ("frictionloss", "armature"):
            setattr(spec.joint(place), kind, value)
        elif kind == "gain":
            spec.actuator(place).gainprm[0] = value
        elif kind == "kp":
            spec.actuator(place).gainprm[0], spec.actuator(place).biasprm[1] = value, -value
        elif kind == "kv":
            spec.actuator(place).biasprm[2] = -value
        else:
            raise ValueError(f"{name}: the toolbox does not know how to set it")

    return change
