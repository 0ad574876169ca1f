"""Numbers and vectors of several worlds at once: the SIMD lanes of a processor.

On CPU a thread advances `WIDTH` worlds in step, each in a lane of vector registers; on CUDA a thread block advances one world,
and the functions that are written for lanes are called with plain `float` and `wp.vec3`. Lanes never mix, so that a world comes
out bitwise the same whichever worlds are beside it.

Modules that compute with lanes import the operators `add`, `sub`, `mul` and `div`: Warp finds them by these names for + - * / and
falls back to its own for all other types. Annotations stay real objects here (no postponed evaluation), because Warp reads them.
"""

import warp as wp

WIDTH = 16
"""Worlds that a thread advances together: as many as AVX-512 has lanes. Processors with shorter registers take several turns."""

Numbers = wp.types.vector(WIDTH, wp.float32)
"""A number of each world."""
Vectors = wp.types.vector(3 * WIDTH, wp.float32)
"""A vector of each world: all x, then all y, then all z."""


_LANE_TYPE = f"typedef float lane_t __attribute__((ext_vector_type({WIDTH}), aligned(4)));"


def _snippet(expression: str, result: type, **arguments: type) -> str:
    """Return C++ code that evaluates an expression in all lanes.

    Args:
        expression: Its operands are the names of the arguments as capitals; `[n]` picks a component of a vector.
        result: `Numbers` or `Vectors`, for which the expression is evaluated for x, y and z.
        arguments: Name and type of each argument of the function: `Numbers`, `Vectors` or float.
    """
    num_axes = 3 if result is Vectors else 1
    lines = [_LANE_TYPE, f"wp::vec_t<{num_axes * WIDTH}, float> result;"]
    for axis in range(num_axes):
        code = expression
        for name, kind in arguments.items():
            pointer = f"((const lane_t*)&{name})"
            value = f"(lane_t)({name})" if kind is float else f"{pointer}[{axis if kind is Vectors else 0}]"
            code = code.replace(f"{name.upper()}[", f"{pointer}[").replace(name.upper(), value)
        lines.append(f"((lane_t*)&result)[{axis}] = {code};")
    return "\n".join([*lines, "return result;"])


@wp.func_native(_snippet("A + B", Numbers, a=Numbers, b=Numbers))
def _add_numbers(a: Numbers, b: Numbers) -> Numbers: ...


@wp.func_native(_snippet("A - B", Numbers, a=Numbers, b=Numbers))
def _subtract_numbers(a: Numbers, b: Numbers) -> Numbers: ...


@wp.func_native(_snippet("A * B", Numbers, a=Numbers, b=Numbers))
def _multiply_numbers(a: Numbers, b: Numbers) -> Numbers: ...


@wp.func_native(_snippet("A * B", Numbers, a=Numbers, b=float))
def _scale_numbers(a: Numbers, b: float) -> Numbers: ...


@wp.func_native(_snippet("A / B", Numbers, a=Numbers, b=Numbers))
def _divide_numbers(a: Numbers, b: Numbers) -> Numbers: ...


@wp.func_native(_snippet("A + B", Vectors, a=Vectors, b=Vectors))
def _add_vectors(a: Vectors, b: Vectors) -> Vectors: ...


@wp.func_native(_snippet("A - B", Vectors, a=Vectors, b=Vectors))
def _subtract_vectors(a: Vectors, b: Vectors) -> Vectors: ...


@wp.func_native(_snippet("A * B", Vectors, a=Vectors, b=Numbers))
def _multiply_vectors(a: Vectors, b: Numbers) -> Vectors: ...


@wp.func_native(_snippet("A * B", Vectors, a=Vectors, b=float))
def _scale_vectors(a: Vectors, b: float) -> Vectors: ...


@wp.func_native(_snippet("A / B", Vectors, a=Vectors, b=Numbers))
def _divide_vectors(a: Vectors, b: Numbers) -> Vectors: ...


@wp.func_native(_snippet("A[0] * B[0] + A[1] * B[1] + A[2] * B[2]", Numbers, a=Vectors, b=Vectors))
def _inner_product(a: Vectors, b: Vectors) -> Numbers: ...


@wp.func_native(
    f"""
    {_LANE_TYPE}
    wp::vec_t<{3 * WIDTH}, float> result;
    const lane_t* first = (const lane_t*)&a;
    const lane_t* second = (const lane_t*)&b;
    lane_t* product = (lane_t*)&result;
    product[0] = first[1] * second[2] - first[2] * second[1];
    product[1] = first[2] * second[0] - first[0] * second[2];
    product[2] = first[0] * second[1] - first[1] * second[0];
    return result;
    """
)
def _cross_product(a: Vectors, b: Vectors) -> Vectors: ...


@wp.func_native(_snippet("__builtin_elementwise_sqrt(A)", Numbers, a=Numbers))
def _square_root(a: Numbers) -> Numbers: ...


@wp.func_native(_snippet("A < B ? A : B", Numbers, a=Numbers, b=Numbers))
def _minimum(a: Numbers, b: Numbers) -> Numbers: ...


@wp.func_native(_snippet("A > B ? A : B", Numbers, a=Numbers, b=Numbers))
def _maximum(a: Numbers, b: Numbers) -> Numbers: ...


@wp.func_native(_snippet("A < B ? A : B", Vectors, a=Vectors, b=Vectors))
def _minimum_vectors(a: Vectors, b: Vectors) -> Vectors: ...


@wp.func_native(_snippet("A > B ? A : B", Vectors, a=Vectors, b=Vectors))
def _maximum_vectors(a: Vectors, b: Vectors) -> Vectors: ...


@wp.func_native(_snippet("A > 0.0f ? B : C", Numbers, a=Numbers, b=Numbers, c=Numbers))
def _choose_numbers(a: Numbers, b: Numbers, c: Numbers) -> Numbers: ...


@wp.func_native(_snippet("A[0] > 0.0f ? B : C", Vectors, a=Numbers, b=Vectors, c=Vectors))
def _choose_vectors(a: Numbers, b: Vectors, c: Vectors) -> Vectors: ...


@wp.func_native(_snippet("B", Numbers, a=Numbers, b=float))
def _spread_number(a: Numbers, b: float) -> Numbers: ...


@wp.func_native(_snippet("B", Vectors, a=Vectors, b=float))
def _spread_vector(a: Vectors, b: float) -> Vectors: ...


@wp.func_native(f"{_LANE_TYPE} return __builtin_reduce_or(*(const lane_t*)&a > 0.0f) != 0;")
def _any_positive(a: Numbers) -> bool: ...


@wp.func
def add(a: Numbers, b: Numbers):
    """Return a + b."""
    return _add_numbers(a, b)


@wp.func
def add(a: Vectors, b: Vectors):  # noqa: F811 (overloads)
    """Return a + b."""
    return _add_vectors(a, b)


@wp.func
def sub(a: Numbers, b: Numbers):
    """Return a - b."""
    return _subtract_numbers(a, b)


@wp.func
def sub(a: Vectors, b: Vectors):  # noqa: F811
    """Return a - b."""
    return _subtract_vectors(a, b)


@wp.func
def mul(a: Numbers, b: Numbers):
    """Return a * b."""
    return _multiply_numbers(a, b)


@wp.func
def mul(a: Numbers, b: float):  # noqa: F811
    """Return a * b."""
    return _scale_numbers(a, b)


@wp.func
def mul(a: Vectors, b: Numbers):  # noqa: F811
    """Return a * b."""
    return _multiply_vectors(a, b)


@wp.func
def mul(a: Vectors, b: float):  # noqa: F811
    """Return a * b."""
    return _scale_vectors(a, b)


@wp.func
def div(a: Numbers, b: Numbers):
    """Return a / b."""
    return _divide_numbers(a, b)


@wp.func
def div(a: Vectors, b: Numbers):  # noqa: F811
    """Return a / b."""
    return _divide_vectors(a, b)


@wp.func
def inner(a: Vectors, b: Vectors):
    """Return the inner product a . b."""
    return _inner_product(a, b)


@wp.func
def inner(a: wp.vec3, b: wp.vec3):  # noqa: F811
    """Return the inner product a . b."""
    return wp.dot(a, b)


@wp.func
def cross(a: Vectors, b: Vectors):
    """Return the vector product a x b."""
    return _cross_product(a, b)


@wp.func
def cross(a: wp.vec3, b: wp.vec3):  # noqa: F811
    """Return the vector product a x b."""
    return wp.cross(a, b)


@wp.func
def root(a: Numbers):
    """Return the square root of a."""
    return _square_root(a)


@wp.func
def root(a: float):  # noqa: F811
    """Return the square root of a."""
    return wp.sqrt(a)


@wp.func
def lesser(a: Numbers, b: Numbers):
    """Return the smaller of a and b."""
    return _minimum(a, b)


@wp.func
def lesser(a: float, b: float):  # noqa: F811
    """Return the smaller of a and b."""
    return wp.min(a, b)


@wp.func
def lesser(a: Vectors, b: Vectors):  # noqa: F811
    """Return the smaller of a and b, component by component."""
    return _minimum_vectors(a, b)


@wp.func
def lesser(a: wp.vec3, b: wp.vec3):  # noqa: F811
    """Return the smaller of a and b, component by component."""
    return wp.min(a, b)


@wp.func
def greater(a: Numbers, b: Numbers):
    """Return the larger of a and b."""
    return _maximum(a, b)


@wp.func
def greater(a: float, b: float):  # noqa: F811
    """Return the larger of a and b."""
    return wp.max(a, b)


@wp.func
def greater(a: Vectors, b: Vectors):  # noqa: F811
    """Return the larger of a and b, component by component."""
    return _maximum_vectors(a, b)


@wp.func
def greater(a: wp.vec3, b: wp.vec3):  # noqa: F811
    """Return the larger of a and b, component by component."""
    return wp.max(a, b)


@wp.func
def choose(a: Numbers, b: Numbers, c: Numbers):
    """Return b in worlds where a > 0, c in the others."""
    return _choose_numbers(a, b, c)


@wp.func
def choose(a: Numbers, b: Vectors, c: Vectors):  # noqa: F811
    """Return b in worlds where a > 0, c in the others."""
    return _choose_vectors(a, b, c)


@wp.func
def choose(a: float, b: float, c: float):  # noqa: F811
    """Return b in worlds where a > 0, c in the others."""
    return wp.where(a > 0.0, b, c)


@wp.func
def choose(a: float, b: wp.vec3, c: wp.vec3):  # noqa: F811
    """Return b in worlds where a > 0, c in the others."""
    return wp.where(a > 0.0, b, c)


@wp.func
def any_positive(a: Numbers) -> bool:
    """Return whether a > 0 in any world."""
    return _any_positive(a)


@wp.func
def any_positive(a: float) -> bool:  # noqa: F811
    """Return whether a > 0 in any world."""
    return a > 0.0


@wp.func
def spread(a: Numbers, b: float):
    """Return b in every lane, of the type of a."""
    return _spread_number(a, b)


@wp.func
def spread(a: Vectors, b: float):  # noqa: F811
    """Return b in every lane and component, of the type of a."""
    return _spread_vector(a, b)


@wp.func
def spread(a: float, b: float):  # noqa: F811
    """Return b in every lane, of the type of a."""
    return b


@wp.func
def spread(a: wp.vec3, b: float):  # noqa: F811
    """Return b in every lane and component, of the type of a."""
    return wp.vec3(b, b, b)
