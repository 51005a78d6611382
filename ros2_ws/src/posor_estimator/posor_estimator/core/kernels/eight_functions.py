"""The functions of eight floats abreast, and of eight conditions, for numba: see ``eights_in_numba``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor_estimator.core.compiled import EIGHT
from posor_estimator.core.kernels.eights_in_numba import (
    INDEX,
    VECTOR,
    Conditions,
    Eight,
    cgutils,
    extending,
    ir,
    spread,
    types,
)

if TYPE_CHECKING:
    from collections.abc import Callable

AT_ONCE = {math.sqrt: "sqrt", math.floor: "floor", abs: "fabs"}
"""What the processor does with eight numbers at once."""
ONE_BY_ONE = {math.sin: 1, math.cos: 1, math.atan2: 2}
"""What is computed of each alone, by how many numbers it is of."""


def _all_spread(context: Any, builder: Any, values: Any, kinds: Any) -> list[Any]:
    return [spread(context, builder, value, kind) for value, kind in zip(values, kinds, strict=True)]


def _select(typing_context: Any, condition: Any, a: Any, b: Any) -> Any:  # noqa: ARG001  as numba asks
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.select(*_all_spread(context, builder, values, signature.args))

    return Eight(condition, a, b), generate


select = extending.intrinsic(_select)


def _compared(how: str, bits: int) -> Any:
    """Return the function that compares eight conditions, as bits of a number, with such a number."""

    def function(typing_context: Any, condition: Any) -> Any:  # noqa: ARG001  as numba asks
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:  # noqa: ARG001
            kind = ir.IntType(EIGHT)
            return builder.icmp_unsigned(how, builder.bitcast(values[0], kind), ir.Constant(kind, bits))

        return types.boolean(condition), generate

    return extending.intrinsic(function)


def _negation(typing_context: Any, condition: Any) -> Any:  # noqa: ARG001  as numba asks
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:  # noqa: ARG001
        return builder.not_(values[0])

    return Conditions(condition), generate


def _at_once(name: str) -> Any:
    """Return the function that is an instruction for eight numbers."""

    def function(typing_context: Any, a: Any) -> Any:  # noqa: ARG001  as numba asks
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:  # noqa: ARG001
            kind = ir.FunctionType(VECTOR, [VECTOR])
            return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v8f64"), values)

        return Eight(a), generate

    return extending.intrinsic(function)


def _one_by_one(scalar: Any, count: int) -> Any:
    """Return the function that asks ``scalar`` eight times."""
    each = types.float64(*[types.float64] * count)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        spread_out = _all_spread(context, builder, values, signature.args)
        function = context.get_function(scalar, each)
        out = ir.Constant(VECTOR, ir.Undefined)
        for index in range(EIGHT):
            at = ir.Constant(INDEX, index)
            one = function(builder, [builder.extract_element(values, at) for values in spread_out])
            out = builder.insert_element(out, one, at)
        return out

    def of_one(typing_context: Any, a: Any) -> Any:
        typing_context.resolve_function_type(scalar, each.args, {})
        return Eight(a), generate

    def of_two(typing_context: Any, a: Any, b: Any) -> Any:
        typing_context.resolve_function_type(scalar, each.args, {})
        return Eight(a, b), generate

    return extending.intrinsic(of_one if count == 1 else of_two)


def _let(function: Any, meaning: Callable[..., Any]) -> None:
    """Let numba know a function: ``meaning`` returns what does it for arguments of some types, or None."""
    extending.overload(function, strict=False)(meaning)


def _of_one(function: Any, instruction: Any) -> None:
    _let(function, lambda a: (lambda a: instruction(a)) if a == Eight else None)  # noqa: PLW0108  no intrinsic itself


def _of_two(function: Any, instruction: Any) -> None:
    _let(function, lambda a, b: (lambda a, b: instruction(a, b)) if Eight in (a, b) else None)  # noqa: PLW0108


def _answer(question: Any, instruction: Any, of_one: Any) -> None:
    """Let an instruction answer a question about eight conditions, and ``of_one`` that about a single one."""
    _let(question, lambda a: (lambda a: instruction(a)) if a == Conditions else of_one)  # noqa: PLW0108


def register(chosen: Any, everywhere: Any, anywhere: Any, opposite: Any) -> None:
    """Tell numba what the functions of ``kernels.eight`` do, with eights and with single numbers."""
    _let(
        chosen,
        lambda condition, a, b: (  # noqa: ARG005  numba looks at the names
            (lambda condition, a, b: select(condition, a, b))  # noqa: PLW0108  no intrinsic itself
            if condition == Conditions
            else (lambda condition, a, b: a if condition else b)
        ),
    )
    _answer(everywhere, _compared("==", 2**EIGHT - 1), lambda a: a)
    _answer(anywhere, _compared("!=", 0), lambda a: a)
    _answer(opposite, extending.intrinsic(_negation), lambda a: not a)
    _let(min, lambda a, b: (lambda a, b: select(b < a, b, a)) if Eight in (a, b) else None)
    _let(max, lambda a, b: (lambda a, b: select(b > a, b, a)) if Eight in (a, b) else None)
    for function, name in AT_ONCE.items():
        _of_one(function, _at_once(name))
    for function, count in ONE_BY_ONE.items():
        (_of_one if count == 1 else _of_two)(function, _one_by_one(function, count))
