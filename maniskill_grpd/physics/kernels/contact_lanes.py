"""Contacts of one world in the lanes of vector registers: as many are computed at once as worlds are elsewhere.

For groups of single worlds, on CUDA, every thread computes one contact: the same functions exist for numbers and vectors.
Contacts are fetched in full registers. Behind the last one of a world lie entries that are computed and not used; they
refer to nodes that exist.
"""

import warp as wp

from maniskill_grpd.physics.kernels.lanes import WIDTH, Numbers, Vectors


@wp.func_native(
    f"""
    wp::vec_t<{3 * WIDTH}, float> result;
    for (int l = 0; l < {WIDTH}; ++l) {{
        const float* values = (const float*)wp::address(array, group, (*wp::address(nodes, world, first + l))[k]);
        result[l] = values[lane];
        result[{WIDTH} + l] = values[{WIDTH} + lane];
        result[{2 * WIDTH} + l] = values[{2 * WIDTH} + lane];
    }}
    return result;
    """
)
def _gather_vectors(
    array: wp.array2d(dtype=Vectors), group: int, lane: int, nodes: wp.array2d(dtype=wp.vec4i), world: int, first: int, k: int
) -> Vectors: ...


@wp.func_native(
    f"""
    wp::vec_t<{WIDTH}, float> result;
    for (int l = 0; l < {WIDTH}; ++l) {{
        const float* values = (const float*)wp::address(array, group, (*wp::address(nodes, world, first + l))[k]);
        result[l] = values[lane];
    }}
    return result;
    """
)
def _gather_numbers(
    array: wp.array2d(dtype=Numbers), group: int, lane: int, nodes: wp.array2d(dtype=wp.vec4i), world: int, first: int, k: int
) -> Numbers: ...


@wp.func_native(
    f"""
    wp::vec_t<{3 * WIDTH}, float> result;
    for (int l = 0; l < {WIDTH}; ++l) {{
        wp::vec3 value = *wp::address(array, world, first + l);
        result[l] = value[0];
        result[{WIDTH} + l] = value[1];
        result[{2 * WIDTH} + l] = value[2];
    }}
    return result;
    """
)
def _load_vectors(array: wp.array2d(dtype=wp.vec3), world: int, first: int) -> Vectors: ...


@wp.func_native(
    f"""
    wp::vec_t<{WIDTH}, float> result;
    for (int l = 0; l < {WIDTH}; ++l) result[l] = *wp::address(array, world, first + l);
    return result;
    """
)
def _load_numbers(array: wp.array2d(dtype=float), world: int, first: int) -> Numbers: ...


@wp.func_native(
    f"""
    for (int l = 0; l < {WIDTH}; ++l)
        *wp::address(array, world, first + l) = wp::vec3(value[l], value[{WIDTH} + l], value[{2 * WIDTH} + l]);
    """
)
def _store_vectors(array: wp.array2d(dtype=wp.vec3), world: int, first: int, value: Vectors): ...


@wp.func_native(f"for (int l = 0; l < {WIDTH}; ++l) *wp::address(array, world, first + l) = value[l];")
def _store_numbers(array: wp.array2d(dtype=float), world: int, first: int, value: Numbers): ...


@wp.func
def gather(
    array: wp.array2d(dtype=Vectors), group: int, lane: int, nodes: wp.array2d(dtype=wp.vec4i), world: int, first: int, k: int
):
    """Return what the k-th nodes of the contacts of a world from `first` on have in one lane of a group."""
    return _gather_vectors(array, group, lane, nodes, world, first, k)


@wp.func
def gather(  # noqa: F811
    array: wp.array2d(dtype=Numbers), group: int, lane: int, nodes: wp.array2d(dtype=wp.vec4i), world: int, first: int, k: int
):
    """Return what the k-th nodes of the contacts of a world from `first` on have in one lane of a group."""
    return _gather_numbers(array, group, lane, nodes, world, first, k)


@wp.func
def gather(  # noqa: F811
    array: wp.array2d(dtype=wp.vec3), group: int, lane: int, nodes: wp.array2d(dtype=wp.vec4i), world: int, first: int, k: int
):
    """Return what the k-th node of a contact has."""
    return array[group, nodes[world, first][k]]


@wp.func
def gather(  # noqa: F811
    array: wp.array2d(dtype=float), group: int, lane: int, nodes: wp.array2d(dtype=wp.vec4i), world: int, first: int, k: int
):
    """Return what the k-th node of a contact has."""
    return array[group, nodes[world, first][k]]


@wp.func
def load(like: Vectors, array: wp.array2d(dtype=wp.vec3), world: int, first: int):
    """Return the entries of a world from `first` on, as many as `like` has lanes."""
    return _load_vectors(array, world, first)


@wp.func
def load(like: wp.vec3, array: wp.array2d(dtype=wp.vec3), world: int, first: int):  # noqa: F811
    """Return an entry of a world."""
    return array[world, first]


@wp.func
def load(like: Numbers, array: wp.array2d(dtype=float), world: int, first: int):  # noqa: F811
    """Return the entries of a world from `first` on, as many as `like` has lanes."""
    return _load_numbers(array, world, first)


@wp.func
def load(like: float, array: wp.array2d(dtype=float), world: int, first: int):  # noqa: F811
    """Return an entry of a world."""
    return array[world, first]


@wp.func
def store(array: wp.array2d(dtype=wp.vec3), world: int, first: int, value: Vectors):
    """Write entries of a world from `first` on."""
    _store_vectors(array, world, first, value)


@wp.func
def store(array: wp.array2d(dtype=wp.vec3), world: int, first: int, value: wp.vec3):  # noqa: F811
    """Write an entry of a world."""
    array[world, first] = value


@wp.func
def store(array: wp.array2d(dtype=float), world: int, first: int, value: Numbers):  # noqa: F811
    """Write entries of a world from `first` on."""
    _store_numbers(array, world, first, value)


@wp.func
def store(array: wp.array2d(dtype=float), world: int, first: int, value: float):  # noqa: F811
    """Write an entry of a world."""
    array[world, first] = value
