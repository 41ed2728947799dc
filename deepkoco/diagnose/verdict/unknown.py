"""Explained share, carry-over to held-out windows, and a description of the residuals that no cause explains."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from deepkoco.diagnose.gain import Gain
from deepkoco.diagnose.residuals.residuals import Dispersion, MissingTorque
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit

# Keys of position, speed and missing load, of a joint that turns and of one that slides.
WORST = {
    "torque": ("theta_rad", "omega_rad_s", "torque_nm"),
    "force": ("position_m", "speed_m_s", "force_n"),
}
MIN_CARRY_OVER = 0.25  # fall of chi2 per held-out window over that per fitted window
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


def explained_share(
    before: Fit, after: Fit, windows: Windows, floor: float, held: Gain | None = None
) -> float:
    """Share of the excess chi2 that the causes explain, in the channel where this share is largest.

    The excess is chi2 per sample above the floor. A channel with glitches (many speed estimates have them) keeps
    its excess under any cause. The largest share is taken so that such a channel does not hide the others.

    Args:
        before: Fit without the causes.
        after: Fit with them.
        windows: Their windows.
        floor: chi2 per sample that no cause has to explain.
        held: Held-out windows, which count as well: a push that explains all of the fitted ones explains little where
            those that it does not touch differ as much. None leaves them out.
    """
    shares, valid, pairs = [], [windows.valid], [(before, after)]
    if held is not None:
        valid.append(held.replayed.valid)
        pairs.append((held.fits["refit"], held.fits["extended"]))
    for c in range(windows.valid.shape[1]):
        samples = sum(int(v[:, c].sum()) for v in valid)
        if samples:
            left = [
                sum(float((fit.residual[:, c] ** 2).sum()) for fit in fits) / samples
                for fits in zip(*pairs, strict=True)
            ]
            shares.append((left[0] - left[1]) / max(left[0] - floor, 1e-12) if left[0] > floor else 0.0)
    return max(shares, default=0.0)


def carries_over(
    before: Fit, after: Fit, held_before: Fit, held_after: Fit, lasting: np.ndarray | None = None
) -> bool:
    """Return whether the causes improve the held-out windows as they improve the fitted windows.

    A false cause improves only the windows that it was fitted to. The falls of chi2 per window are compared as two
    samples. A cause that acts in few windows (a saturation) has a large variance between windows and passes.

    Args:
        before: Refit on the fitted windows.
        after: Fit with the named causes on the fitted windows.
        held_before: Parameters of the refit on the held-out windows.
        held_after: Parameters of the fit with the named causes on the held-out windows.
        lasting: (W,) fitted windows that no push touches; None for all windows.
    """
    fitted, kept = _fall(before, after), _fall(held_before, held_after)
    fitted = fitted if lasting is None else fitted[lasting]
    if len(fitted) < 2 or len(kept) == 0:
        return True
    spread = float(fitted.std(ddof=1)) * float(np.sqrt(1.0 / len(fitted) + 1.0 / len(kept)))
    short = float(fitted.mean() - kept.mean())
    return bool(kept.mean() >= MIN_CARRY_OVER * fitted.mean() or short <= 3.0 * spread)


def _fall(before: Fit, after: Fit) -> np.ndarray:
    """(W,) fall of chi2 in each window."""
    return ((before.residual**2).sum((1, 2)) - (after.residual**2).sum((1, 2))).numpy()


def describe(missing: Sequence[MissingTorque], spread: Dispersion) -> dict[str, Any]:
    """Describe the remaining residuals for the report.

    Args:
        missing: Missing load of each joint.
        spread: Dispersion of the residuals.

    Returns:
        ``chi2_per_sample``, ``lag_one`` (correlation of neighbours, 0 if white), ``kurtosis`` of the
        missing torque (0 if normal; large for a few pushes), its ``correlations`` with simple terms in
        angle and speed, and ``worst`` (time and joint, position, speed and missing load where that load is
        largest; keys name their units).
    """
    # The joint is described whose missing load is largest against its standard deviation.
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
