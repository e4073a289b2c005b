"""A user's own law inside compiled models: called by address, so that kernels stay cached."""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


@intrinsic
def call_law(typing: Any, address: Any, values: Any, state: Any, slope: Any, out: Any) -> Any:
    """Call the law at ``address`` with the data of four float64 arrays."""
    arrays = (values, state, slope, out)
    if not isinstance(address, types.Integer) or not all(
        isinstance(one, types.Array) and one.dtype == types.float64 for one in arrays
    ):
        return None
    signature = types.void(address, *arrays)

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = ir.DoubleType().as_pointer()
        function = ir.FunctionType(ir.VoidType(), [pointer] * 4)
        target = builder.inttoptr(arguments[0], function.as_pointer())
        data = [
            cgutils.create_struct_proxy(kind)(context, builder, value=value).data
            for kind, value in zip(signature.args[1:], arguments[1:], strict=True)
        ]
        builder.call(target, [builder.bitcast(one, pointer) for one in data])
        return context.get_dummy_value()

    return signature, codegen
