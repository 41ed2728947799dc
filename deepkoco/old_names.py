"""Old names: modules and names that have moved are found at their new place, with a DeprecationWarning."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from importlib.abc import InspectLoader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import CodeType, ModuleType
from typing import Any

import lazy_loader

# (old package, new package, modules; "old>new" where the module has a new name as well)
MOVED = (
    ("deepkoco", "deepkoco", "commands>cli identify>fit"),
    ("deepkoco", "deepkoco.cli", "command_line>input_error"),
    ("deepkoco", "deepkoco.logs", "inspection>inspect"),
    ("deepkoco", "deepkoco.output", "new_folder picture"),
    (
        "deepkoco.analysis",
        "deepkoco.analysis.measures",
        "collect comparison contribution eigenfunctions eigenvalues horizon input_maps inputs "
        "learning linearity modes plans points pruning replays rollout saliency sensitivity steps "
        "view wrapped_model",
    ),
    ("deepkoco.analysis", "deepkoco.analysis.page", "analyse film_run plan_film words"),
    ("deepkoco.analysis", "deepkoco.output", "colours"),
    ("deepkoco.commands", "deepkoco.cli", "export_command>export show_command>show"),
    ("deepkoco.diagnose", "deepkoco.cli", "command>diagnose"),
    ("deepkoco.diagnose", "deepkoco.diagnose", "design>experiment_design refits>per_log_refits"),
    (
        "deepkoco.diagnose",
        "deepkoco.diagnose.evidence",
        "allowed>seen_when_healthy beyond>sanity_checks classes elimination forward hints>start_values "
        "pushed>event_windows residual_model screening selection settling>refine_ranking",
    ),
    (
        "deepkoco.diagnose",
        "deepkoco.diagnose.lost_commands",
        "loss_pattern>sequence losses>report lost>search",
    ),
    ("deepkoco.diagnose", "deepkoco.diagnose.report", "page remains>unexplained_text words>text"),
    (
        "deepkoco.diagnose",
        "deepkoco.diagnose.report.figures",
        "error_map figures>all_figures friction_figure layout missing_figure parameter_figures "
        "ranking_figure timing_figure",
    ),
    (
        "deepkoco.diagnose",
        "deepkoco.diagnose.residuals",
        "friction_curve missing_curve noise_left>whiteness scatter signatures spectrum",
    ),
    (
        "deepkoco.diagnose",
        "deepkoco.diagnose.verdict",
        "advice findings scattered>noise_causes shortage unknown",
    ),
    ("deepkoco.diagnose", "deepkoco.output", "versions"),
    ("deepkoco.diagnose.design", "deepkoco.cli", "command>design_experiment"),
    (
        "deepkoco.diagnose.design",
        "deepkoco.diagnose.experiment_design",
        "hand>log_at_hand hold>stabiliser stage>experiment_setup",
    ),
    ("deepkoco.graph", "deepkoco.graph", "realtime>live"),
    ("deepkoco.graph", "deepkoco.graph.episodes", "episode episode_tables>tables fitting storage"),
    ("deepkoco.graph", "deepkoco.graph.execution", "cells cuda eager fused policy runtime schedule state"),
    ("deepkoco.graph", "deepkoco.graph.model", "connection contract graph node"),
    (
        "deepkoco.graph",
        "deepkoco.graph.timing",
        "computation_graph drawn_delays>drawn overrides replay timing_kernel>kernel timing_plan>plan",
    ),
    ("deepkoco.graph", "deepkoco.logs", "log_files>formats log_series>series recording sidecar units"),
    ("deepkoco.graph", "deepkoco.logs.checks", "derivative log_checks>channel_checks log_frozen>frozen"),
    ("deepkoco.graph.storage", "deepkoco.graph.episodes", "export"),
    ("deepkoco.identify", "deepkoco.cli", "command>identify"),
    ("deepkoco.identify", "deepkoco.fit", "question>request trial>fit_types"),
    ("deepkoco.identify", "deepkoco.fit.data", "known>per_log_differences noise windows"),
    ("deepkoco.identify", "deepkoco.fit.delays", "hidden_delay linear_delays trainable_delay"),
    (
        "deepkoco.identify",
        "deepkoco.fit.simulate",
        "effort>command_effort push sensor_filter simulate>simulator",
    ),
    (
        "deepkoco.identify",
        "deepkoco.fit.solve",
        "dispersion identifiability levenberg_marquardt methods "
        "normal>normal_equations nuisances prior search>cma sharpen>residual_noise "
        "zeros>encoder_zeros",
    ),
    ("deepkoco.identify", "deepkoco.fit.state", "estimator unscented"),
    ("deepkoco.inspection", "deepkoco.cli", "command>inspect"),
    ("deepkoco.interchange", "deepkoco.cli", "command>export_model"),
    (
        "deepkoco.koopman",
        "deepkoco.koopman.files",
        "folder_files frame_arrays lifted_arrays model_card model_folder network_arrays stored_values",
    ),
    ("deepkoco.koopman", "deepkoco.koopman.lifting", "edmdc lifted_linear network"),
    ("deepkoco.koopman", "deepkoco.koopman.model", "cost encoder frame_encoder mlp rollout"),
    (
        "deepkoco.systems",
        "deepkoco.systems.bodies",
        "circling_target double_pendulum furuta_pendulum pendulum quadrotor_height rod_pendulum "
        "servo_pendulum torque_pendulum two_link_arm",
    ),
    ("deepkoco.unit", "deepkoco.cli", "record_command>record systems_command>systems"),
    ("deepkoco.unit", "deepkoco.excitation", "excitation played record"),
    ("deepkoco.unit", "deepkoco.logs.inspect", "log_summary"),
)
# (package, name): the package or module that has the name now
MOVED_NAMES = {
    **{("deepkoco.graph", name): "deepkoco.logs" for name in ("LogError", "Recording", "Series")},
    **{("deepkoco.graph", name): "deepkoco.logs" for name in ("read_log", "write_log")},
    **{("deepkoco.unit", name): "deepkoco.excitation" for name in ("EXCITATIONS", "Excitation")},
    **{("deepkoco.unit", name): "deepkoco.excitation" for name in ("ExcitationError", "make_excitation")},
    ("deepkoco.unit", "policy_excitation"): "deepkoco.excitation",
    **{
        ("deepkoco.diagnose.residuals", name): "deepkoco.diagnose.residuals.residuals"
        for name in ("SLOTS", "acting_system", "push_of")
    },
    **{
        ("deepkoco.diagnose.verdict", name): "deepkoco.diagnose.verdict.verdict"
        for name in ("rivalled", "verdict_of")
    },
    **{
        ("deepkoco.graph.episodes.storage", name): "deepkoco.graph.episodes.export"
        for name in ("episode_table", "export_episodes")
    },
    **{
        ("deepkoco.systems.extended", name): "deepkoco.systems.model_yaml"
        for name in ("ModelFileError", "load_model", "save_model")
    },
    **{
        ("deepkoco.systems.system", name): "deepkoco.systems.motion"
        for name in ("CommandTiming", "Delivery", "Timing")
    },
    ("deepkoco.systems.system", "Outline"): "deepkoco.systems.drawn",
    **{("deepkoco.systems.system", n): "deepkoco.systems.named_joints" for n in ("SMOOTHING", "UNREADABLE")},
    ("deepkoco.systems.system", "rk4_step"): "deepkoco.systems.runge_kutta",
}


def moved_modules(rows: Sequence[tuple[str, str, str]]) -> dict[str, str]:
    """Return new module by old module from rows as in `MOVED`."""
    table = {}
    for old, new, modules in rows:
        for module in modules.split():
            before, _, after = module.partition(">")
            table[f"{old}.{before}"] = f"{new}.{after or before}"
    return table


class OldPackage(ModuleType):
    """A package under its old name: everything but the name is that of the new one.

    It is a module of its own because an import binds a submodule to its package. Bound to the new package,
    ``deepkoco.identify.fit`` would replace the function ``deepkoco.fit.fit``.

    Args:
        name: Old name.
        new: The package at its new place.
    """

    def __init__(self, name: str, new: ModuleType) -> None:
        super().__init__(name, new.__doc__)
        self.__dict__["_new"] = new

    def __getattr__(self, name: str) -> Any:
        return getattr(self._new, name)

    def __setattr__(self, name: str, value: object) -> None:
        if name.startswith("__"):
            super().__setattr__(name, value)
        elif not (isinstance(value, ModuleType) and hasattr(self._new, name)):
            setattr(self._new, name, value)


class MovedModules(MetaPathFinder, InspectLoader):
    """Finds modules by their old names; the module that it gives is the one at the new place.

    Args:
        table: New module by old module. The modules inside an old package are found as well.
    """

    def __init__(self, table: Mapping[str, str]) -> None:
        self._table = dict(table)
        self._specs: dict[str, ModuleSpec | None] = {}

    def new_name(self, name: str) -> str | None:
        """Return where the module `name` is now, None if it has not moved."""
        head, tail = name, ""
        while "." in head:
            if head in self._table:
                return self._table[head] + tail
            head, _, last = head.rpartition(".")
            tail = f".{last}{tail}"
        return None

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find a moved module, and warn."""
        new = self.new_name(fullname)
        if new is None:
            return None
        text = f"{fullname} has moved to {new}; import it from there"
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        found = ModuleSpec(fullname, self, origin=new)
        place = find_spec(new)
        # `python -m` runs the `__main__` of what has a search path.
        found.submodule_search_locations = None if place is None else place.submodule_search_locations
        return found

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Import the module at its new place."""
        module = import_module(self._place(spec.name))
        if hasattr(module, "__path__"):
            return OldPackage(spec.name, module)
        self._specs[spec.name] = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Give the module its own spec back: it was executed when it was imported at its new place."""
        if isinstance(module, OldPackage):
            return
        names = [old for old in self._specs if self._place(old) == module.__name__]
        module.__spec__ = self._specs[names[-1]]

    def get_code(self, fullname: str) -> CodeType | None:
        """Return the code of the module, for `python -m OLD_NAME`."""
        spec = find_spec(self._place(fullname))
        assert spec is not None
        assert isinstance(spec.loader, InspectLoader)
        return spec.loader.get_code(spec.name)

    def get_source(self, fullname: str) -> str | None:
        """Return the source of the module."""
        spec = find_spec(self._place(fullname))
        assert spec is not None
        assert isinstance(spec.loader, InspectLoader)
        return spec.loader.get_source(spec.name)

    def _place(self, name: str) -> str:
        new = self.new_name(name)
        assert new is not None
        return new


def find_moved(rows: Sequence[tuple[str, str, str]]) -> None:
    """Let imports find moved modules from now on.

    Args:
        rows: As in `MOVED`.
    """
    # First in the row: a package that has moved would otherwise load its modules a second time.
    sys.meta_path.insert(0, MovedModules(moved_modules(rows)))


def names_on_demand(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package whose names are imported when they are asked for.

    The names are those of the stub `__init__.pyi` beside `file`. A control loop on a robot, the process of a unit and
    `deepkoco --help` so import no more than they use. Names that have moved are found too, with a DeprecationWarning.

    Args:
        package: Name of the package.
        file: Its `__file__`.
    """
    found, listed, names = lazy_loader.attach_stub(package, file)
    modules = moved_modules(MOVED)

    def find(name: str) -> Any:
        if (package, name) in MOVED_NAMES:
            return _moved_name(package, name)
        moved = f"{package}.{name}"
        return import_module(moved) if moved in modules else found(name)

    return find, listed, names


def moved_names(package: str) -> Callable[[str], Any]:
    """Return `__getattr__` of a package that finds the names of `MOVED_NAMES`, with a DeprecationWarning.

    Args:
        package: Name of the package.
    """

    def find(name: str) -> Any:
        if (package, name) not in MOVED_NAMES:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return _moved_name(package, name)

    return find


def _moved_name(package: str, name: str) -> Any:
    home = MOVED_NAMES[package, name]
    text = f"{package}.{name} has moved to {home}.{name}; import it from there"
    warnings.warn(text, DeprecationWarning, stacklevel=3)
    return getattr(import_module(home), name)
