"""Commands that make a log informative, and the recording of a unit that is driven by them."""

from deepkoco.excitation.excitation import (
    EXCITATIONS,
    Excitation,
    ExcitationError,
    make_excitation,
    policy_excitation,
)

__all__ = ["EXCITATIONS", "Excitation", "ExcitationError", "make_excitation", "policy_excitation"]
