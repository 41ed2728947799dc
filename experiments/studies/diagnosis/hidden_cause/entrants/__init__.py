"""Methods that take part. A further one is a class with a name and `answer`, given as module:Class."""

from __future__ import annotations

from importlib import import_module

from deepkoco.extras import install_command
from experiments.studies.diagnosis.hidden_cause.questions import Entrant

HERE = "experiments.studies.diagnosis.hidden_cause.entrants"
ENTRANTS = {
    "deepkoco": f"{HERE}.deepkoco:DeepKoCo",
    "usual_set": f"{HERE}.usual_set:UsualSet",
    "mujoco_sysid": f"{HERE}.mujoco_sysid:MujocoSysid",
    "sparse": f"{HERE}.sparse:SparseRegression",
    "network": f"{HERE}.network:ResidualNetwork",
}


class EntrantError(ValueError):
    """There is no such entrant, or it is none."""


def make_entrant(text: str) -> Entrant:
    """Make an entrant from its name in `ENTRANTS` or from ``module:Class``.

    Raises:
        EntrantError: There is none.
    """
    place = ENTRANTS.get(text, text)
    module, _, name = place.partition(":")
    if not name:
        raise EntrantError(f"{text}: give module:Class, or one of {', '.join(ENTRANTS)}")
    try:
        made = getattr(import_module(module), name)()
    except (ImportError, AttributeError) as error:
        hint = f"; {install_command('rivals')}" if text in ENTRANTS else ""
        raise EntrantError(f"{text}: {error}{hint}") from None
    if not isinstance(getattr(made, "name", None), str) or not callable(getattr(made, "answer", None)):
        raise EntrantError(f"{text}: has no name or no answer(handed)")
    return made
