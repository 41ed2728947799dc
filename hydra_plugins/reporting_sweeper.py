"""Hydra's own sweeper, which lists the runs that failed at the end.

Hydra takes sweepers from this package alone; it has no `__init__.py`, for plugins share its name.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.utils import filter_overrides
from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException


class ReportingSweeper(BasicSweeper):
    """Runs all combinations, and fails in the end where one of them did."""

    def sweep(self, arguments: list[str]) -> Any:
        """Run them all; see `BasicSweeper`.

        Raises:
            SweepFailed: A run failed, or the launcher broke off.
        """
        # Hydra imports this module to look for plugins; what it needs would make every start slower.
        from deepkoco.runs.sweep import conclude

        outcomes, stopped = None, None
        try:
            results = super().sweep(arguments)
            outcomes = [result.return_value for batch in results for result in batch]
        except (HydraException, OmegaConfBaseException):
            raise  # settings that do not fit together; nothing was started
        except Exception as error:
            stopped = error
        jobs = [filter_overrides(job) for batch in self.overrides or () for job in batch]
        conclude(jobs, outcomes, self._finished, stopped)
        return outcomes

    def _finished(self, job: Sequence[str]) -> bool:
        from deepkoco.runs.train import is_finished

        assert self.hydra_context is not None
        assert self.config is not None
        config = self.hydra_context.config_loader.load_sweep_config(self.config, list(job))
        return is_finished(Path(config.run))
