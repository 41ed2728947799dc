"""The moment at which a user's system is checked: when it is made."""

from __future__ import annotations

from abc import ABCMeta
from typing import Any

from deepkoco.systems.declaration import EXAMPLES, DeclarationError, check_declaration, complete, lacks
from deepkoco.systems.equations_check import check_equations


class Declared(ABCMeta):
    """Class of the classes of systems: a system is completed and checked as soon as it is made."""

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:
        """Make a system.

        Raises:
            DeclarationError: It declares too little, or what does not go together.
        """
        missing = [name for name in sorted(cls.__abstractmethods__) if name in EXAMPLES]
        if missing:
            raise DeclarationError(lacks(cls.__name__, missing[0]))
        system = super().__call__(*args, **kwargs)
        if not system.wraps:
            complete(system)
            check_declaration(system)
            check_equations(system)
        return system
