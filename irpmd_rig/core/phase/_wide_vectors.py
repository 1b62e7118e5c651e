"""Ask LLVM for 512-bit vectors in one compiled function."""

from __future__ import annotations

from typing import Any

from numba.core import types
from numba.extending import intrinsic


@intrinsic
def wide_vectors(typingctx: Any) -> Any:  # noqa: ARG001 - the signature that numba asks for
    """Let the function that calls this use 512-bit registers where the machine has them.

    LLVM keeps to 256 bits on the AVX-512 machines it knows, for fear of their clock; this arithmetic is
    dense enough to gain a third. Numba offers that choice for a whole process only (NUMBA_CPU_FEATURES), so
    the attribute is set on the function being built. llvmlite refuses attributes that it does not list:
    hence the plain ``set.add``. Other machines ignore the attribute. Vectors that find no register are kept on the
    stack, which has to be aligned for them: unaligned, each would lie on two lines of the cache.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ARG001
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        set.add(builder.function.attributes, "alignstack(64)")
        return context.get_dummy_value()

    return types.void(), codegen
