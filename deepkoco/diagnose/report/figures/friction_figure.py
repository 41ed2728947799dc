"""Picture of the friction of a joint over its speed, without and with the named cause."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.diagnosis import Details, Diagnosis
from deepkoco.diagnose.report.figures.layout import COLOURS, Layout
from deepkoco.diagnose.residuals.friction_curve import friction_curve
from deepkoco.output.picture import Picture


def friction_picture(diagnosis: Diagnosis, details: Details, layout: Layout) -> Picture | None:
    """Draw the friction without and with the named cause; None unless a cause of the friction family is named."""
    named = [c for c in diagnosis.causes if c.family == "friction"]
    if not named:
        return None
    known = catalogue(details.system.base)
    joint = known[named[0].name].joint or 0
    omega = np.abs(details.missing[joint].omega)
    fastest = float(np.quantile(omega, 0.98)) or 1.0
    curves = {
        "refitted": friction_curve(details.system, details.refit, joint, fastest, details.inflation),
        "with the named cause": friction_curve(
            details.system, details.final, joint, fastest, details.inflation
        ),
    }
    figure = Figure(figsize=(layout.width, 3.4))
    axis = figure.subplots()
    frame: dict[str, np.ndarray] = {}
    for (label, curve), colour in zip(curves.items(), (COLOURS["refit"], COLOURS["extended"]), strict=True):
        axis.fill_between(curve.speed, curve.low, curve.high, color=colour, alpha=0.2, lw=0)
        axis.plot(curve.speed, curve.load, color=colour, label=f"simulation {label}")
        short = label.split()[0].replace("with", "extended")
        frame |= {
            "speed": curve.speed,
            short: curve.load,
            f"{short}_low": curve.low,
            f"{short}_high": curve.high,
        }
    unit = details.system.state_units[details.system.joints + joint]
    of_joint = f" of {details.system.joint_names[joint]}" if details.system.own_joints > 1 else ""
    axis.set_xlabel(f"speed{of_joint} [{unit}]")
    axis.set_ylabel(f"friction [{details.missing[joint].unit}]")
    figure.legend(loc="outside upper center", ncols=min(2, layout.entries))
    caption = (
        "Total load against the motion at zero command, with 95 % bands. Different friction laws can give "
        "nearly the same curve over the speeds of the log. So the curve is more certain than the name of the law."
    )
    return Picture("friction_curve", "Friction over speed", caption, figure, pd.DataFrame(frame))
