"""What remains when nothing in the catalogue explains the residuals: describe it, do not name it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from deepkoco.diagnose.residuals.residuals import Dispersion, MissingTorque
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit

# Keys of position, speed and missing load, of a joint that turns and of one that slides.
WORST = {
    "torque": ("theta_rad", "omega_rad_s", "torque_nm"),
    "force": ("position_m", "speed_m_s", "force_n"),
}
CARRIED = 0.25  # share of its fall of chi2 that a cause must keep on windows that no fit saw
# Terms a missing torque is regressed on: name -> function of (theta, omega, load scale).
TERMS = {
    "1": lambda theta, omega: np.ones_like(theta),
    "omega": lambda theta, omega: omega,
    "sign(omega)": lambda theta, omega: np.sign(omega),
    "omega |omega|": lambda theta, omega: omega * np.abs(omega),
    "sin(theta)": lambda theta, omega: np.sin(theta),
    "cos(theta)": lambda theta, omega: np.cos(theta),
    "sin(2 theta)": lambda theta, omega: np.sin(2 * theta),
    "cos(2 theta)": lambda theta, omega: np.cos(2 * theta),
}


def explained_share(before: Fit, after: Fit, windows: Windows, floor: float) -> float:
    """Share of the excess chi2 that the named causes take away, in the channel where that is most.

    A channel that glitches (many speed estimates do) keeps its excess whatever is named, and must not
    hide what another channel shows.
    """
    shares = []
    for c in range(windows.valid.shape[1]):
        samples = int(windows.valid[:, c].sum())
        if samples:
            left = [float((fit.residual[:, c] ** 2).sum()) / samples for fit in (before, after)]
            shares.append((left[0] - left[1]) / max(left[0] - floor, 1e-12) if left[0] > floor else 0.0)
    return max(shares, default=0.0)


def carries_over(
    before: Fit, after: Fit, held_before: Fit, held_after: Fit, lasting: np.ndarray | None = None
) -> bool:
    """Whether windows that no fit saw gain from the named causes as those that were fitted do.

    What only imitates a cause bends to the windows that are fitted. The falls of chi2 by window are compared as two
    samples: a cause that shows in few windows (a saturation) scatters widely and passes.

    Args:
        before: Refit on the fitted windows.
        after: The same with the named causes.
        held_before: The refit's parameters on windows kept back.
        held_after: Those of the named causes there.
        lasting: (W,) fitted windows in which only what lasts acts; None for all.
    """
    fitted, kept = _fall(before, after), _fall(held_before, held_after)
    fitted = fitted if lasting is None else fitted[lasting]
    if len(fitted) < 2 or len(kept) == 0:
        return True
    spread = float(fitted.std(ddof=1)) * float(np.sqrt(1.0 / len(fitted) + 1.0 / len(kept)))
    short = float(fitted.mean() - kept.mean())
    return bool(kept.mean() >= CARRIED * fitted.mean() or short <= 3.0 * spread)


def _fall(before: Fit, after: Fit) -> np.ndarray:
    """(W,) fall of chi2 in each window."""
    return ((before.residual**2).sum((1, 2)) - (after.residual**2).sum((1, 2))).numpy()


def describe(missing: Sequence[MissingTorque], spread: Dispersion) -> dict[str, Any]:
    """Signatures of what remains, for the report.

    Returns:
        ``chi2_per_sample``, ``lag_one`` (correlation of neighbours, 0 if white), ``kurtosis`` of the
        missing torque (0 if normal; large for a few pushes), ``correlations`` of it with simple terms in
        angle and speed, and ``worst`` (time, joint, and with their units in their keys the position, the speed and
        the missing load where it is largest).
    """
    # Of several joints the one is described at which most is missing against what is uncertain.
    loudest = max(missing, key=lambda m: float(((m.torque / m.sd) ** 2).mean()))
    torque = loudest.torque.ravel()
    centred = torque - torque.mean()
    power = float((centred**2).mean())
    theta, omega = loudest.theta.ravel(), loudest.omega.ravel()
    at = int(np.argmax(np.abs(torque)))
    return {
        "chi2_per_sample": spread.chi2_per_sample,
        "lag_one": spread.lag_one,
        "kurtosis": float((centred**4).mean() / max(power**2, 1e-300) - 3.0),
        "correlations": {
            name: _correlation(torque, term(theta, omega)) for name, term in TERMS.items() if name != "1"
        },
        "worst": {
            "time_s": float(loudest.time.ravel()[at]),
            **dict(
                zip(WORST[loudest.load], (float(theta[at]), float(omega[at]), float(torque[at])), strict=True)
            ),
            "joint": loudest.joint + 1,
            "joint_name": loudest.name,
        },
    }


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float((a * b).sum() / max(np.sqrt((a**2).sum() * (b**2).sum()), 1e-300))
