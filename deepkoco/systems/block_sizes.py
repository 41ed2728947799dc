"""Arrays whose inner sizes a compiled function knows: only then its loops over lanes become vector instructions.

The sizes of an array are numbers that are read when a compiled function runs. Two rows of one array are then an unknown
number of lanes apart, so the compiler would have to check every pair of rows in a loop for overlap, and it gives up.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

from numba.core import cgutils, types
from numba.core.imputils import impl_ret_borrowed
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

LANES = 32  # elements of a block


@intrinsic
def _in_lanes(_: Any, array: types.Array) -> tuple[Any, Callable[..., Any]]:
    """Return an array (..., LANES) as one of which the compiler knows the last size."""
    return array(array), _with_sizes(LANES)


@intrinsic(prefer_literal=True)
def _in_rows(_: Any, array: types.Array, rows: types.IntegerLiteral) -> tuple[Any, Callable[..., Any]]:
    """Return an array (..., rows, LANES) as one of which the compiler knows the last two sizes."""
    return array(array, rows), _with_sizes(rows.literal_value, LANES)


def _with_sizes(*inner: int) -> Callable[..., Any]:
    def compiled(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        array = make_array(signature.return_type)(context, builder, args[0])
        sizes = list(cgutils.unpack_tuple(builder, array.shape))
        sizes[-len(inner) :] = [context.get_constant(types.intp, n) for n in inner]
        array.shape = cgutils.pack_array(builder, sizes)
        return impl_ret_borrowed(context, builder, signature.return_type, array._getvalue())

    return compiled


# A compiled function calls them without the context that the compiler hands in.
in_lanes = cast(Callable[[Any], Any], _in_lanes)
in_rows = cast(Callable[[Any, int], Any], _in_rows)
