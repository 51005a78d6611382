"""The types of eight floats abreast, and of eight conditions, for numba: arithmetic, comparisons, arrays of them.

See ``kernels.eight`` for what they are for, and ``eight_functions`` for their functions.
"""

from __future__ import annotations

import operator
from importlib import import_module
from typing import TYPE_CHECKING, Any

from posor_estimator.core.compiled import EIGHT

if TYPE_CHECKING:
    from collections.abc import Callable

# Without annotations, or with some that say too little.
ir: Any = import_module("llvmlite.ir")
types: Any = import_module("numba.core.types")
cgutils: Any = import_module("numba.core.cgutils")
templates: Any = import_module("numba.core.typing.templates")
typeconv: Any = import_module("numba.core.typeconv")
extending: Any = import_module("numba.extending")
arrayobj: Any = import_module("numba.np.arrayobj")

VECTOR = ir.VectorType(ir.DoubleType(), EIGHT)
CONDITIONS = ir.VectorType(ir.IntType(1), EIGHT)
INDEX = ir.IntType(32)

ARITHMETIC = {
    "fadd": (operator.add, operator.iadd),
    "fsub": (operator.sub, operator.isub),
    "fmul": (operator.mul, operator.imul),
    "fdiv": (operator.truediv, operator.itruediv),
}
COMPARISONS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq}
JOINING = {"and_": (operator.and_, operator.iand), "or_": (operator.or_, operator.ior)}


class _Abreast(types.Type):  # type: ignore[misc]
    """Eight values; a single one becomes eight times the same."""

    single: Any

    def can_convert_from(self, typing_context: Any, other: Any) -> Any:  # noqa: ARG002  as numba asks
        """Return how surely another type becomes this one."""
        return typeconv.Conversion.promote if isinstance(other, self.single) else None

    def unify(self, typing_context: Any, other: Any) -> Any:  # noqa: ARG002
        """Return the type of a variable that holds one or the other."""
        return self if isinstance(other, self.single) else None


class EightType(_Abreast):
    """Eight floats."""

    single = types.Number

    def __init__(self) -> None:
        """Give it its name."""
        super().__init__(name="Eight")


class ConditionsType(_Abreast):
    """Eight times yes or no."""

    single = types.Boolean

    def __init__(self) -> None:
        """Give it its name."""
        super().__init__(name="EightConditions")


Eight, Conditions = EightType(), ConditionsType()


class EightModel(extending.models.PrimitiveModel):  # type: ignore[misc]
    """Eight floats are a vector to the processor."""

    def __init__(self, manager: Any, kind: Any) -> None:
        """Say so."""
        super().__init__(manager, kind, VECTOR)


class ConditionsModel(extending.models.PrimitiveModel):  # type: ignore[misc]
    """Eight conditions are a vector of bits."""

    def __init__(self, manager: Any, kind: Any) -> None:
        """Say so."""
        super().__init__(manager, kind, CONDITIONS)


def spread(context: Any, builder: Any, value: Any, kind: Any) -> Any:
    """Return eight times a value; eight of them as they are."""
    if kind in (Eight, Conditions):
        return value
    vector = VECTOR if isinstance(kind, types.Number) else CONDITIONS
    one = context.cast(builder, value, kind, types.float64) if isinstance(kind, types.Number) else value
    undefined = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(undefined, one, ir.Constant(INDEX, 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(ir.VectorType(INDEX, EIGHT), [0] * EIGHT))


def _cast(context: Any, builder: Any, kind: Any, to: Any, value: Any) -> Any:  # noqa: ARG001  as numba asks
    return spread(context, builder, value, kind)


def _allow(operation: Any, result: Any, own: Any, generate: Callable[[Any, Any, Any], Any]) -> None:
    """Let numba know an operation on two, at least one of them of type ``own``; the other may be a number."""

    class Template(templates.AbstractTemplate):  # type: ignore[misc]
        key = operation

        def generic(self, arguments: Any, keywords: Any) -> Any:  # noqa: ARG002  as numba asks
            if own in arguments and all(kind == own or isinstance(kind, types.Number) for kind in arguments):
                return templates.signature(result, *arguments)
            return None

    def instruct(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        both = (spread(context, builder, v, kind) for v, kind in zip(values, signature.args, strict=True))
        return generate(builder, *both)

    templates.infer_global(operation)(Template)
    for kinds in ((type(own), type(own)), (type(own), types.Number), (types.Number, type(own))):
        extending.lower_builtin(operation, *kinds)(instruct)


def _instruction(name: str, *front: str) -> Callable[[Any, Any, Any], Any]:
    return lambda builder, a, b: getattr(builder, name)(*front, a, b)


class _Negative(templates.AbstractTemplate):  # type: ignore[misc]
    key = operator.neg

    def generic(self, arguments: Any, keywords: Any) -> Any:  # noqa: ARG002  as numba asks
        return templates.signature(Eight, Eight) if arguments == (Eight,) else None


def _negative(context: Any, builder: Any, signature: Any, values: Any) -> Any:  # noqa: ARG001  as numba asks
    return builder.fneg(values[0])


def _eights(typing_context: Any, numbers: Any) -> Any:  # noqa: ARG001  as numba asks
    made = types.Array(Eight, 1, "C")

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        flat = arrayobj.make_array(numbers)(context, builder, values[0])
        table = arrayobj.make_array(made)(context, builder)
        item = context.get_constant(types.intp, 8 * EIGHT)
        count = builder.udiv(builder.extract_value(flat.shape, 0), context.get_constant(types.intp, EIGHT))
        arrayobj.populate_array(
            table,
            data=builder.bitcast(flat.data, VECTOR.as_pointer()),
            shape=cgutils.pack_array(builder, [count]),
            strides=cgutils.pack_array(builder, [item]),
            itemsize=item,
            meminfo=flat.meminfo,
            parent=flat.parent,
        )
        return arrayobj.impl_ret_borrowed(context, builder, signature.return_type, table._getvalue())  # noqa: SLF001  its public way

    return made(numbers), generate


eights = extending.intrinsic(_eights)
"""Take a flat array of floats for one of eights, without copying."""

extending.register_model(EightType)(EightModel)
extending.register_model(ConditionsType)(ConditionsModel)
extending.lower_cast(types.Number, EightType)(_cast)
extending.lower_cast(types.Boolean, ConditionsType)(_cast)
templates.infer_global(operator.neg)(_Negative)
extending.lower_builtin(operator.neg, EightType)(_negative)
for _name, _operations in ARITHMETIC.items():
    for _operation in _operations:
        _allow(_operation, Eight, Eight, _instruction(_name))
for _name, _operation in COMPARISONS.items():
    _allow(_operation, Conditions, Eight, _instruction("fcmp_ordered", _name))
for _name, _operations in JOINING.items():
    for _operation in _operations:
        _allow(_operation, Conditions, Conditions, _instruction(_name))
