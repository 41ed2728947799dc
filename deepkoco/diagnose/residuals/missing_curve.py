"""The missing torque that the named causes would leave, were they the whole truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deepkoco.diagnose.diagnosis import Details
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.fit.fit import FitProblem


def expected_missing_torque(details: Details, joint: int) -> np.ndarray:
    """(W, K) [N m or N]: the refitted baseline's missing torque on noise-free data of the final model.

    The residual measured - refit is replaced by final - refit, and deconvolved in the same way, so that
    what the refit absorbs of a cause is taken into account.
    """
    clean = replace(details.refit, residual=details.refit.residual - details.final.residual)
    return missing_torque(FitProblem(details.system, details.windows), clean, details.inflation)[joint].torque
