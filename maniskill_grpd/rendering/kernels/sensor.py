"""Random numbers of sensors, each world's from its own seed, and what a depth sensor makes of exact images."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def write_normal(seeds: wp.array(dtype=int), numbers: wp.array2d(dtype=float)):
    """Write one normally distributed number of one world."""
    world, index = wp.tid()
    state = wp.rand_init(seeds[world], index)
    numbers[world, index] = wp.randn(state)


@wp.kernel
def write_uniform(seeds: wp.array(dtype=int), numbers: wp.array2d(dtype=float)):
    """Write one number of one world that is uniform in [0, 1)."""
    world, index = wp.tid()
    state = wp.rand_init(seeds[world], index)
    numbers[world, index] = wp.randf(state)


@wp.kernel
def measure_depth(
    depth: wp.array2d(dtype=float),
    seeds: wp.array(dtype=int),
    noise: float,
    step: float,
    dropout: float,
    measured: wp.array2d(dtype=float),
):
    """Write what a sensor says of one pixel's depth; 0 for nothing."""
    world, pixel = wp.tid()
    exact = depth[world, pixel]
    state = wp.rand_init(seeds[world], pixel)
    is_lost = wp.randf(state) < dropout
    found = float(0.0)
    if exact > 0.0 and not is_lost:
        nearness = 1.0 / exact + noise * wp.randn(state)
        if step > 0.0:
            nearness = wp.round(nearness / step) * step
        if nearness > 0.0:
            found = 1.0 / nearness
    measured[world, pixel] = found
