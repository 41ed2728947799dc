"""Commands that make a log informative, and the recording of a unit that is driven by them."""

from deepkoco.excitation.excitation import EXCITATIONS, make_excitation
from deepkoco.excitation.policy import policy_excitation
from deepkoco.excitation.signal import Excitation, ExcitationError

__all__ = ["EXCITATIONS", "Excitation", "ExcitationError", "make_excitation", "policy_excitation"]
