"""Write what pykoopman makes of a recording: python make_pykoopman_reference.py OUT.json.

pykoopman 1.2.1 needs numpy<=1.26 and scikit-learn==1.1.3, so it lives in an environment of its own:
pip install numpy==1.26.0 scipy==1.11.2 scikit-learn==1.1.3 pydmd==0.4.1 optht derivative prettytable matplotlib, then
pip install --no-deps pykoopman==1.2.1. With this repository on PYTHONPATH the fitted objects are imported as well.
"""

import json
import sys
import types
from pathlib import Path

import numpy as np


class _Absent(types.ModuleType):
    """Stands in for torch and lightning, which only pykoopman's neural regressors need."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (), {})


for name in ("", ".nn", ".nn.utils", ".nn.utils.rnn", ".nn.functional", ".utils", ".utils.data", ".optim"):
    sys.modules["torch" + name] = _Absent("torch" + name)
sys.modules["lightning"] = _Absent("lightning")
sys.modules["torch"].nn = sys.modules["torch.nn"]

import pykoopman  # noqa: E402
from pykoopman.observables import (  # noqa: E402
    CustomObservables,
    Identity,
    Polynomial,
    RadialBasisFunction,
    RandomFourierFeatures,
    TimeDelay,
)
from pykoopman.regression import EDMDc  # noqa: E402

STEPS = 120


def recording() -> tuple[np.ndarray, np.ndarray]:
    """A forced Van der Pol oscillator, one episode."""
    rng = np.random.default_rng(0)
    u = rng.uniform(-2, 2, (STEPS, 1))
    x = [np.array([1.0, 0.0])]
    for k in range(STEPS - 1):
        p, v = x[-1]
        x.append(np.array([p + 0.05 * v, v + 0.05 * ((1 - p**2) * v - p + u[k, 0])]))
    return np.array(x).round(9), u.round(9)


def main(out: Path) -> None:
    x, u = recording()
    centers = np.random.default_rng(1).uniform(-2, 2, (2, 5)).round(6)
    liftings = {
        "Identity": Identity(),
        "Polynomial": Polynomial(degree=3),
        "RadialBasisFunction": RadialBasisFunction("thinplate", 5, centers, 1.3, 1.0, True),
        "RandomFourierFeatures": RandomFourierFeatures(gamma=0.3, D=6, random_state=2),
        "TimeDelay": TimeDelay(delay=2, n_delays=2),
        "CustomObservables": CustomObservables([lambda p: np.sin(p), lambda p, v: p * v]),
    }
    cases = {}
    for name, observables in liftings.items():
        model = pykoopman.Koopman(observables=observables, regressor=EDMDc())
        consumed = getattr(observables, "n_consumed_samples", 0) if name == "TimeDelay" else 0
        model.fit(x, u=u[consumed:], dt=0.05)
        kept = (
            "degree",
            "include_bias",
            "interaction_only",
            "centers",
            "rbf_type",
            "kernel_width",
            "w",
            "delay",
        )
        kept += ("polyharmonic_coeff", "include_state", "n_delays", "n_input_features_")
        cases[name] = {
            "observables": {k: getattr(observables, k) for k in kept if hasattr(observables, k)},
            "lifted": observables.transform(x)[:5],
            "A": model.A,
            "B": model.B,
            "C": model.C,
        }
        check_import(model, cases[name], x)
    plain = json.loads(json.dumps({"x": x, "u": u, "cases": cases}, default=lambda value: value.tolist()))
    del plain["cases"]["CustomObservables"]
    out.write_text(json.dumps(plain) + "\n")


def check_import(model, case, x) -> None:
    """Import the fitted object itself, where this repository can be imported too."""
    try:
        from deepkoco.interchange.pykoopman import from_pykoopman
        from deepkoco.koopman.lifting.edmdc import TargetCost
        from deepkoco.koopman.lifting.lifting import stack_history
    except ImportError as error:
        print(f"not imported into deepkoco: {error}")
        return
    ours = from_pykoopman(model, TargetCost([1.0, 1.0], [0.0, 0.0], 0.1), 0.05)
    np.testing.assert_allclose(
        ours.lifting(stack_history(x, ours.lifting.window)[:5]), case["lifted"], atol=1e-12
    )
    np.testing.assert_array_equal(ours.transition, case["A"])
    print(type(ours.lifting).__name__, "imported")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
