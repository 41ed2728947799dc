"""Missing torque that is expected if the named causes are the only ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deepkoco.diagnose.diagnosis import Details
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.fit.fit import FitProblem


def expected_missing_torque(details: Details, joint: int) -> np.ndarray:
    """Return the missing load (W, K) [N m or N] of the refitted baseline on noise-free data of the final model.

    The residual measured - refit is replaced by final - refit and deconvolved in the same way. The result therefore
    lacks the part of a cause that the refit absorbs, as the missing load of the log does.
    """
    clean = replace(details.refit, residual=details.refit.residual - details.final.residual)
    return missing_torque(FitProblem(details.system, details.windows), clean, details.inflation)[joint].torque
