"""Parameters of one make: what a model gives several joints with one value, their drives have in common.

The six servos of an arm are of one kind, and its model file says so: it gives all of them one stiffness, one damping,
one rotor. If that stiffness is wrong, it is wrong for all of them alike, and each servo then differs from the others as
little as units do. A log that shows only the ratio of one servo's stiffness and friction, because no weight loads that
joint, gets the scale from the joints that gravity loads.

Source: Gelman et al., Bayesian Data Analysis, ch. 5: exchangeable groups with a mean of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from deepkoco.diagnose.baseline import Baseline

OF_BODIES = ("mass", "com_x", "com_y", "com_z", "inertia_x", "inertia_y", "inertia_z")
LEAST = 0.02  # share of the value given that a group's own spread is computed from at least
FAR = 3.0  # standard deviations of that spread, from which a joint is no longer one of the group


def groups_of(declared: Baseline, names: Sequence[str]) -> list[list[int]]:
    """Return the indices of parameters that are of one kind and have one value in the model.

    Args:
        declared: The baseline; parameters of bodies belong to no group.
        names: Parameters to group.
    """
    found: dict[tuple[str, str, float], list[int]] = {}
    for i, name in enumerate(names):
        kind, _, place = name.partition("(")
        if place and kind not in OF_BODIES and declared.values[name] != 0.0:
            unit = declared.system.parameter(name).unit
            found.setdefault((kind, unit, declared.values[name]), []).append(i)
    return [own for own in found.values() if len(own) > 1]


def covariance_of(
    declared: Baseline, names: Sequence[str], values: Mapping[str, float], settled: bool
) -> np.ndarray:
    """Return the prior covariance of parameters around their values as given, given how far a fit is from these.

    A single parameter is as wide as its distance. Those of a group share the distance of their median, and differ from
    each other by the same share of it as their declared standard deviation is of the value given. One that a settled
    fit has far from the others is no longer of the group.

    Args:
        declared: The baseline with its prior as declared.
        names: Parameters.
        values: Their values in a fit.
        settled: Whether this fit was made under such a prior; else it may have no reason to differ between joints.
    """
    index = [declared.prior.names.index(n) for n in names]
    centre, variance = declared.prior.centre[index], declared.prior.covariance.diagonal()[index]
    at = np.array([values[n] for n in names])
    covariance = np.diag(np.maximum(variance, (at - centre) ** 2))
    for group in groups_of(declared, names):
        given, level = centre[group], float(np.median(at[group]))
        own = np.sqrt(variance[group]) * max(abs(level / given[0]), LEAST)
        inside = np.abs(at[group] - level) <= FAR * own if settled else np.ones(len(group), bool)
        like = [g for g, yes in zip(group, inside, strict=True) if yes]
        if len(like) < 2:
            continue
        common = (float(np.median(at[like])) - given[0]) ** 2
        covariance[np.ix_(like, like)] = common + np.diag(own[inside] ** 2)
    return covariance
