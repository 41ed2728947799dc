"""Excitations: commands that give a log information. `record` drives a unit with them and records it."""

from deepkoco.excitation.excitation import EXCITATIONS, make_excitation
from deepkoco.excitation.policy import policy_excitation
from deepkoco.excitation.signal import Excitation, ExcitationError

__all__ = ["EXCITATIONS", "Excitation", "ExcitationError", "make_excitation", "policy_excitation"]
