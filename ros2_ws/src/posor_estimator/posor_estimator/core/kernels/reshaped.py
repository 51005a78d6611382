"""A part of a flat array as a table, without numba's general reshape, which costs more than the arithmetic of a row."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar

from posor_estimator.core.compiled import COMPILING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Numbers = TypeVar("Numbers", np.float64, np.int64)


def viewed(numbers: NDArray[Numbers], start: int, rows: int, columns: int) -> NDArray[Numbers]:
    """Return ``rows * columns`` entries of a contiguous array from ``start`` on as a table, without copying."""
    return numbers[start : start + rows * columns].reshape((rows, columns))


part = viewed

if COMPILING:
    from numba.core import types
    from numba.extending import intrinsic

    # Numba's own, without annotations.
    cgutils: Any = import_module("numba.core.cgutils")
    imputils: Any = import_module("numba.core.imputils")
    arrayobj: Any = import_module("numba.np.arrayobj")

    @intrinsic
    def _part(typing_context: Any, numbers: Any, start: Any, rows: Any, columns: Any) -> Any:  # noqa: ARG001  as numba asks
        made = types.Array(numbers.dtype, 2, "C")

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            flat = arrayobj.make_array(numbers)(context, builder, arguments[0])
            table = arrayobj.make_array(made)(context, builder)
            size = context.get_abi_sizeof(context.get_data_type(numbers.dtype))
            item = context.get_constant(types.intp, size)
            arrayobj.populate_array(
                table,
                data=builder.gep(flat.data, [arguments[1]]),
                shape=cgutils.pack_array(builder, arguments[2:4]),
                strides=cgutils.pack_array(builder, [builder.mul(arguments[3], item), item]),
                itemsize=item,
                meminfo=flat.meminfo,
                parent=flat.parent,
            )
            return imputils.impl_ret_borrowed(context, builder, signature.return_type, table._getvalue())  # noqa: SLF001  its public way

        return made(numbers, types.intp, types.intp, types.intp), generate

    part = _part  # type: ignore[assignment]
