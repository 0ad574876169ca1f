"""Lanes compute what numpy computes, each for itself."""

import numpy as np
import warp as wp

from maniskill_grpd.physics.kernels.lane_access import pick, put
from maniskill_grpd.physics.kernels.lanes import (  # noqa: F401 (operators on lanes)
    WIDTH,
    Numbers,
    Vectors,
    add,
    any_positive,
    choose,
    div,
    greater,
    inner,
    lesser,
    mul,
    root,
    spread,
    sub,
)


@wp.kernel(module="unique", enable_backward=False)
def compute(
    numbers: wp.array2d(dtype=Numbers),
    vectors: wp.array2d(dtype=Vectors),
    flags: wp.array(dtype=bool),
    number_results: wp.array2d(dtype=Numbers),
    vector_results: wp.array2d(dtype=Vectors),
):
    a = numbers[0, 0]
    b = numbers[0, 1]
    x = vectors[0, 0]
    y = vectors[0, 1]
    number_results[0, 0] = a + b
    number_results[0, 1] = a - b
    number_results[0, 2] = a * b
    number_results[0, 3] = a / b
    number_results[0, 4] = root(b)
    number_results[0, 5] = lesser(a, b)
    number_results[0, 6] = greater(a, b)
    number_results[0, 7] = choose(a, b, a)
    number_results[0, 8] = spread(a, 3.0)
    number_results[0, 9] = inner(x, spread(x, 1.0))
    vector_results[0, 0] = x + y
    vector_results[0, 1] = x - y
    vector_results[0, 2] = x * a
    vector_results[0, 3] = x / b
    vector_results[0, 4] = choose(a, x, y)
    vector_results[0, 5] = x * 2.0
    flags[0] = any_positive(a)
    flags[1] = any_positive(b - b)
    for lane in range(WIDTH):
        put(vector_results, 0, 6, lane, pick(vectors, 0, 0, lane) * 3.0)
        put(number_results, 0, 10, lane, pick(numbers, 0, 0, lane) * 3.0)


def test_lanes_agree_with_numpy():
    generator = np.random.default_rng(0)
    a, b = generator.normal(size=(2, WIDTH)).astype(np.float32)
    b = np.abs(b) + np.float32(0.1)
    x, y = generator.normal(size=(2, 3, WIDTH)).astype(np.float32)
    numbers = wp.array(np.stack([a, b])[None], dtype=Numbers, device="cpu")
    vectors = wp.array(np.stack([x, y]).reshape(1, 2, 3 * WIDTH), dtype=Vectors, device="cpu")
    flags = wp.zeros(2, dtype=bool, device="cpu")
    number_results = wp.zeros((1, 11), dtype=Numbers, device="cpu")
    vector_results = wp.zeros((1, 7), dtype=Vectors, device="cpu")
    wp.launch(compute, dim=1, inputs=[numbers, vectors, flags, number_results, vector_results], device="cpu")
    expected = [
        a + b,
        a - b,
        a * b,
        a / b,
        np.sqrt(b),
        np.minimum(a, b),
        np.maximum(a, b),
        np.where(a > 0, b, a),
        np.full_like(a, 3.0),
        x.sum(axis=0),
        3.0 * a,
    ]
    np.testing.assert_allclose(number_results.numpy()[0], np.stack(expected), rtol=1e-6, atol=1e-6)
    expected = [x + y, x - y, x * a, x / b, np.where(a > 0, x, y), 2.0 * x, 3.0 * x]
    np.testing.assert_allclose(vector_results.numpy()[0].reshape(7, 3, WIDTH), np.stack(expected), rtol=1e-6)
    assert flags.numpy().tolist() == [True, False]
