"""One world among those in the lanes: reading and writing what belongs to it.

Like the arithmetic in `lanes`, every function takes arrays of lanes on the CPU and plain arrays on CUDA.
"""

import warp as wp

from maniskill_grpd.physics.kernels.lanes import WIDTH, Numbers, Vectors


@wp.func
def component(a: Numbers, lane: int):
    """Return what one lane holds."""
    return a[lane]


@wp.func
def component(a: float, lane: int):  # noqa: F811
    """Return what one lane holds."""
    return a


@wp.func_native("const float* lanes = (const float*)wp::address(array, group, column); return lanes[lane];")
def _pick_number(array: wp.array2d(dtype=Numbers), group: int, column: int, lane: int) -> float: ...


@wp.func_native(
    f"""
    const float* lanes = (const float*)wp::address(array, group, column);
    return wp::vec3(lanes[lane], lanes[{WIDTH} + lane], lanes[{2 * WIDTH} + lane]);
    """
)
def _pick_vector(array: wp.array2d(dtype=Vectors), group: int, column: int, lane: int) -> wp.vec3: ...


@wp.func_native("((float*)wp::address(array, group, column))[lane] = value;")
def _put_number(array: wp.array2d(dtype=Numbers), group: int, column: int, lane: int, value: float): ...


@wp.func_native(
    f"""
    float* lanes = (float*)wp::address(array, group, column);
    lanes[lane] = value[0]; lanes[{WIDTH} + lane] = value[1]; lanes[{2 * WIDTH} + lane] = value[2];
    """
)
def _put_vector(array: wp.array2d(dtype=Vectors), group: int, column: int, lane: int, value: wp.vec3): ...


@wp.func
def pick(array: wp.array2d(dtype=Numbers), group: int, column: int, lane: int):
    """Return what one lane holds."""
    return _pick_number(array, group, column, lane)


@wp.func
def pick(array: wp.array2d(dtype=Vectors), group: int, column: int, lane: int):  # noqa: F811
    """Return what one lane holds."""
    return _pick_vector(array, group, column, lane)


@wp.func
def pick(array: wp.array2d(dtype=float), group: int, column: int, lane: int):  # noqa: F811
    """Return what one lane holds."""
    return array[group, column]


@wp.func
def pick(array: wp.array2d(dtype=wp.vec3), group: int, column: int, lane: int):  # noqa: F811
    """Return what one lane holds."""
    return array[group, column]


@wp.func
def put(array: wp.array2d(dtype=Numbers), group: int, column: int, lane: int, value: float):
    """Write into one lane."""
    _put_number(array, group, column, lane, value)


@wp.func
def put(array: wp.array2d(dtype=Vectors), group: int, column: int, lane: int, value: wp.vec3):  # noqa: F811
    """Write into one lane."""
    _put_vector(array, group, column, lane, value)


@wp.func
def put(array: wp.array2d(dtype=float), group: int, column: int, lane: int, value: float):  # noqa: F811
    """Write into one lane."""
    array[group, column] = value


@wp.func
def put(array: wp.array2d(dtype=wp.vec3), group: int, column: int, lane: int, value: wp.vec3):  # noqa: F811
    """Write into one lane."""
    array[group, column] = value
