"""Shaded pictures: coverage by brute force, hidden surfaces, translucency, shadows, and that wiping leaves nothing."""

import numpy as np
import pytest

from maniskill_grpd.rendering import Lens, palette
from maniskill_grpd.rendering.canvas import SAMPLES, Canvas, ShadedMesh

RED, GREEN, BLUE, BLACK = *np.eye(3), np.zeros(3)
LENS, FOV = Lens(20, 16), 1.2
HEIGHT = 1.0
LOOK_DOWN = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, HEIGHT], [0, 0, 0, 1]])  # the picture's right is -y, its top +x


def make_canvas(lens=LENS, meshes=()):
    canvas = Canvas(lens, FOV, LOOK_DOWN)
    canvas.set_ground(tuple(BLACK), list(meshes))
    return canvas


def mesh(triangles, fronts, backs=None):
    """Return separate triangles (F, 3, 3), facing up, in the colours of their fronts (F, 3)."""
    fronts = np.broadcast_to(fronts, (len(triangles), 3))
    vertices = np.asarray(triangles, dtype=float).reshape(-1, 3)
    normals = np.broadcast_to([0.0, 0.0, 1.0], vertices.shape)
    return ShadedMesh(vertices, normals, np.arange(len(vertices)).reshape(-1, 3), fronts, fronts if backs is None else backs)


def square(z, half=0.3, center=(0.0, 0.0)):
    """Return two triangles that make a level square, counter-clockwise from above."""
    corners = np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]]) + [*center, 0.0]
    return corners[[[0, 1, 2], [0, 2, 3]]]


def unlit(canvas, triangles, color):
    canvas.paint(canvas.shade(mesh(triangles, color), is_lit=False))


def sample_rays():
    """Return where the rays of the samples meet the plane z = 0, (2 H, 2 W, 2)."""
    height, width = SAMPLES * LENS.height, SAMPLES * LENS.width
    focal = height / 2.0 / np.tan(FOV / 2.0)
    x = -(np.arange(height)[:, None] + 0.5 - height / 2.0) / focal
    y = -(np.arange(width) + 0.5 - width / 2.0) / focal
    return HEIGHT * np.stack(np.broadcast_arrays(x, y), axis=-1)


def test_the_samples_whose_rays_meet_a_triangle_are_covered():
    rays, generator = sample_rays(), np.random.default_rng(0)
    for corners in generator.uniform(-1.2, 1.2, size=(40, 3, 2)):
        canvas = make_canvas()
        unlit(canvas, np.pad(corners, ((0, 0), (0, 1)))[None], RED)
        along, offset = np.roll(corners, -1, axis=0) - corners, rays[:, :, None] - corners
        side = along[:, 0] * offset[..., 1] - along[:, 1] * offset[..., 0]
        inside = (side > 0.0).all(axis=-1) | (side < 0.0).all(axis=-1)
        is_sure = np.abs(side).min(axis=-1) > 1e-5
        np.testing.assert_array_equal((canvas.nearness > 0.0)[is_sure], inside[is_sure])


def test_depths_are_those_of_the_rays():
    canvas = make_canvas()
    tilted = square(0.0, half=0.5)
    tilted[..., 2] = 0.4 * tilted[..., 0] + 0.2
    unlit(canvas, tilted, RED)
    rays = sample_rays()
    depth = (HEIGHT - 0.2) / (1.0 + 0.4 * rays[..., 0] / HEIGHT)  # where the ray is at z = 0.4 x + 0.2
    seen = canvas.nearness > 0.0
    assert seen.sum() > 300
    np.testing.assert_allclose(1.0 / canvas.nearness[seen], depth[seen], rtol=1e-5)


def test_neighbouring_triangles_leave_no_gap():
    canvas = make_canvas()
    unlit(canvas, square(0.0, half=5.0), RED)
    assert (canvas.nearness > 0.0).all()


@pytest.mark.parametrize("order", [1, -1])
def test_the_nearest_is_seen_in_whatever_order_it_is_painted(order):
    canvas = make_canvas()
    for z, color in ((0.0, RED), (0.2, BLUE))[::order]:
        unlit(canvas, square(z, half=0.2), color)
    middle = canvas.colors[SAMPLES * 8, SAMPLES * 10]
    np.testing.assert_array_equal(middle, BLUE)


def test_what_is_behind_the_camera_or_has_no_area_is_not_drawn():
    canvas = make_canvas()
    unlit(canvas, square(HEIGHT + 0.1, half=5.0), RED)
    around = square(0.0, half=0.3)
    around[0, 0, 2] = HEIGHT + 0.1
    unlit(canvas, around[:1], RED)
    unlit(canvas, [[[0.0, 0, 0], [0.1, 0.1, 0], [0.2, 0.2, 0]]], RED)
    assert (canvas.nearness == 0.0).all()


def test_each_side_has_its_color():
    for triangles, expected in ((square(0.0), RED), (square(0.0)[:, ::-1], GREEN)):
        canvas = make_canvas()
        backs = np.broadcast_to(GREEN, (2, 3))
        canvas.paint(canvas.shade(mesh(triangles, RED, backs), is_lit=False))
        np.testing.assert_array_equal(canvas.colors[SAMPLES * 8, SAMPLES * 10], expected)


def test_what_faces_the_lamp_is_brighter():
    bright, dark = (palette.LIGHT_DIRECTION, -palette.LIGHT_DIRECTION)
    shades = []
    for normal in (bright, dark):
        canvas, flat = make_canvas(), mesh(square(0.0), GREEN)
        turned = ShadedMesh(flat.vertices, np.broadcast_to(normal, flat.vertices.shape), flat.faces, flat.fronts, flat.backs)
        canvas.paint(canvas.shade(turned))
        shades.append(canvas.colors[SAMPLES * 8, SAMPLES * 10, 1])
    assert shades[0] > 1.5 * shades[1] > 0.0


@pytest.mark.parametrize(("z", "share"), [(0.3, 0.5), (0.1, 0.25)])
def test_a_glaze_is_fainter_behind_something_and_only_its_front_counts(z, share):
    canvas = make_canvas()
    unlit(canvas, square(0.2), RED)
    layers = np.concatenate([square(z), square(z - 0.05)])
    film = canvas.shade(mesh(layers, np.repeat([GREEN, BLUE], 2, axis=0)), is_lit=False)
    near = canvas.nearness.copy()
    for _ in range(2):  # the film of the first is gone before the second
        canvas.glaze(film, alpha=0.5, hidden_alpha=0.25)
    once = (1.0 - share) * RED + share * GREEN
    np.testing.assert_allclose(canvas.colors[SAMPLES * 8, SAMPLES * 10], (1.0 - share) * once + share * GREEN, atol=1e-6)
    np.testing.assert_array_equal(canvas.nearness, near)


@pytest.mark.parametrize(("lead", "is_covered"), [(0.0, False), (0.05, True)])
def test_a_glaze_must_lead_by_what_is_asked(lead, is_covered):
    canvas = make_canvas(meshes=[mesh(square(0.0, half=5.0), BLACK)])
    unlit(canvas, square(0.1, half=0.2), RED)
    canvas.glaze(canvas.shade(mesh(square(0.12, half=0.4), GREEN), is_lit=False), alpha=1.0, lead=lead)
    np.testing.assert_array_equal(canvas.colors[SAMPLES * 8, SAMPLES * 10], RED if is_covered else GREEN)
    beside = canvas.colors[SAMPLES * 8, SAMPLES * 10 - 9]  # before the ground it does not have to lead
    np.testing.assert_array_equal(beside, GREEN)


def test_shadows_lie_where_the_light_does_not_come():
    lens = Lens(100, 80)
    canvas = make_canvas(lens, meshes=[mesh(square(0.0, half=5.0), np.ones(3))])
    before = canvas.picture().astype(int)
    canvas.cast_shadows(mesh(square(0.2, half=0.1), RED), half_size=5.0, height=0.0)
    darker = (before - canvas.picture()).max(axis=-1)
    rows, columns = np.nonzero(darker > 60)
    x = -(rows + 0.5 - lens.height / 2.0) * np.tan(FOV / 2.0) / (lens.height / 2.0)
    y = -(columns + 0.5 - lens.width / 2.0) * np.tan(FOV / 2.0) / (lens.height / 2.0)
    light = palette.LIGHT_DIRECTION
    np.testing.assert_allclose([x.mean(), y.mean()], -0.2 * light[:2] / light[2], atol=0.02)
    full = round(255 * palette.SHADOW_DARKNESS)
    assert abs(int(darker.max()) - full) <= 1
    assert ((darker > 2) & (darker < full - 2)).any()  # soft edges


def test_pixels_are_means_of_their_samples():
    canvas = make_canvas()
    unlit(canvas, square(0.0, half=0.33, center=(0.02, 0.05)), np.array([0.2, 0.6, 1.0]))
    samples = canvas.colors.reshape(LENS.height, SAMPLES, LENS.width, SAMPLES, 3)
    expected = np.floor(samples.mean(axis=(1, 3)) * 255.0 + 0.5)
    assert np.abs(canvas.picture() - expected).max() <= 1


@pytest.mark.parametrize("size", [(20, 16), (37, 53), (64, 64)])
def test_wiping_leaves_nothing(size):
    """Work is done tile by tile; whatever was drawn before, a picture is the same as on a new canvas."""
    lens, ground, generator = Lens(*size), [mesh(square(0.0, half=0.6), BLUE)], np.random.default_rng(1)

    def draw(canvas, seed):
        shapes = np.random.default_rng(seed).uniform(-0.9, 0.9, size=(4, 3, 3)) * [1.0, 1.0, 0.4]
        canvas.wipe()
        canvas.cast_shadows(mesh(shapes, RED), half_size=0.6, height=0.001)
        canvas.paint(canvas.shade(mesh(shapes[:2], RED)))
        canvas.draw_edges()
        canvas.glaze(canvas.shade(mesh(shapes[2:], GREEN)), alpha=0.5, hidden_alpha=0.2)
        return canvas.picture()

    used = make_canvas(lens, ground)
    for seed in generator.integers(0, 5, 8):
        np.testing.assert_array_equal(draw(used, seed), draw(make_canvas(lens, ground), seed))
    used.wipe()
    np.testing.assert_array_equal(used.picture(), make_canvas(lens, ground).picture())
