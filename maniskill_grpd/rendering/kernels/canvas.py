"""Shaded triangles, shadows, outlines and translucent layers on one picture, tile by tile where something is drawn."""

import warp as wp

from maniskill_grpd.rendering.kernels.triangles import MIN_DOUBLE_AREA, crossing, first_center

wp.set_module_options({"enable_backward": False})

TILE = wp.constant(16)  # side of the tiles [samples]
BLUR = wp.constant(2)  # pixels on either side over which the edge of a shadow is averaged


@wp.struct
class Layer:
    """H x W samples; nearness is the inverse depth [1/m], 0 infinitely far."""

    nearness: wp.array2d(dtype=float)
    colors: wp.array2d(dtype=wp.vec3)
    tiles: wp.array2d(dtype=wp.uint8)  # 1 where something was drawn since the last wipe
    width: int
    height: int


@wp.struct
class Eye:
    """A pinhole camera that looks along x, y left and z up, and the light of its pictures."""

    axes: wp.mat33  # rows: the camera's axes in the world
    position: wp.vec3
    focal: float  # [samples]
    center: wp.vec2  # [samples]
    nearest: float  # what is nearer is not seen [m]
    lamp: wp.vec3  # unit, towards the lamp
    view: wp.vec3  # unit, from the origin to the camera
    glossy: wp.vec3  # unit, the normal that reflects the lamp into the camera
    shares: wp.vec3  # of the light from everywhere, from the lamp and from the camera
    gloss: float
    gloss_exponent: float


@wp.struct
class Mesh:
    """F triangles with smooth normals, and the colours of their two sides."""

    vertices: wp.array(dtype=wp.vec3)
    normals: wp.array(dtype=wp.vec3)
    faces: wp.array(dtype=wp.vec3i)
    fronts: wp.array(dtype=wp.vec3)
    backs: wp.array(dtype=wp.vec3)


@wp.func
def to_samples(point: wp.vec3, eye: Eye) -> wp.vec3:
    """Return where a point of the world appears, x right and y down, and its nearness; 0 where it is not in front."""
    local = eye.axes * (point - eye.position)
    if not local[0] > eye.nearest:
        return wp.vec3(0.0, 0.0, 0.0)
    scale = eye.focal / local[0]
    return wp.vec3(eye.center[0] - scale * local[1], eye.center[1] - scale * local[2], 1.0 / local[0])


@wp.func
def lit(color: wp.vec3, normal: wp.vec3, eye: Eye) -> wp.vec3:
    """Return the colour that a surface of some colour scatters and reflects into the camera."""
    brightness = eye.shares[0] + eye.shares[1] * wp.max(wp.dot(normal, eye.lamp), 0.0)
    brightness += eye.shares[2] * wp.max(wp.dot(normal, eye.view), 0.0)
    shine = eye.gloss * wp.pow(wp.max(wp.dot(normal, eye.glossy), 0.0), eye.gloss_exponent)
    return brightness * color + wp.vec3(shine, shine, shine)


@wp.kernel
def shade(mesh: Mesh, eye: Eye, is_lit: bool, places: wp.array2d(dtype=wp.vec3), colors: wp.array2d(dtype=wp.vec3)):
    """Write where the corners of a triangle appear, and their colours on the side that is seen."""
    face = wp.tid()
    corners = mesh.faces[face]
    a = mesh.vertices[corners[0]]
    outward = wp.cross(mesh.vertices[corners[1]] - a, mesh.vertices[corners[2]] - a)
    side = float(1.0)
    color = mesh.fronts[face]
    if wp.dot(outward, eye.position - a) <= 0.0:
        side = -1.0
        color = mesh.backs[face]
    for corner in range(3):
        places[face, corner] = to_samples(mesh.vertices[corners[corner]], eye)
        shown = color
        if is_lit:
            shown = lit(color, side * mesh.normals[corners[corner]], eye)
        colors[face, corner] = shown


@wp.kernel
def cast(mesh: Mesh, eye: Eye, half: float, height: float, places: wp.array2d(dtype=wp.vec3)):
    """Write where the shadows of the corners of a triangle appear on a square table at z = 0, at a height just above it."""
    face = wp.tid()
    for corner in range(3):
        point = mesh.vertices[mesh.faces[face][corner]]
        fallen = point - (wp.max(point[2], 0.0) / eye.lamp[2]) * eye.lamp
        on_table = wp.vec3(wp.clamp(fallen[0], -half, half), wp.clamp(fallen[1], -half, half), height)
        places[face, corner] = to_samples(on_table, eye)


@wp.func
def mark(low: wp.vec2, high: wp.vec2, layer: Layer):
    """Mark the tiles that a rectangle of samples touches."""
    left = int(wp.clamp(low[0], 0.0, float(layer.width - 1))) // TILE
    right = int(wp.clamp(high[0], 0.0, float(layer.width - 1))) // TILE
    top = int(wp.clamp(low[1], 0.0, float(layer.height - 1))) // TILE
    bottom = int(wp.clamp(high[1], 0.0, float(layer.height - 1))) // TILE
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            layer.tiles[row, column] = wp.uint8(1)


@wp.func
def by_height(p: wp.vec3, q: wp.vec3, r: wp.vec3) -> wp.mat33:
    """Return three points as rows, from the uppermost to the lowest."""
    a = p
    b = q
    c = r
    if a[1] > b[1]:
        a = q
        b = p
    if b[1] > c[1]:
        c = b
        b = r
        if a[1] > b[1]:
            swapped = a
            a = b
            b = swapped
    return wp.matrix_from_rows(a, b, c)


@wp.func
def span(row: int, a: wp.vec3, b: wp.vec3, c: wp.vec3, width: int) -> wp.vec2i:
    """Return the first column of a row whose centre is in a triangle, and the first behind it; corners from top to bottom."""
    y = float(row) + 0.5
    far_side = crossing(y, a, c)
    near_side = float(0.0)
    if y < b[1]:
        near_side = crossing(y, a, b)
    else:
        near_side = crossing(y, b, c)
    return wp.vec2i(first_center(wp.min(near_side, far_side), width), first_center(wp.max(near_side, far_side), width))


@wp.kernel
def paint(places: wp.array2d(dtype=wp.vec3), colors: wp.array2d(dtype=wp.vec3), margin: float, layer: Layer):
    """Paint all triangles of which every corner is in front of the camera, where they are the nearest."""
    edge = wp.vec2(margin, margin)
    for face in range(places.shape[0]):
        p = places[face, 0]
        q = places[face, 1]
        r = places[face, 2]
        area = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
        if p[2] > 0.0 and q[2] > 0.0 and r[2] > 0.0 and wp.abs(area) > MIN_DOUBLE_AREA:
            rows = by_height(p, q, r)
            a = rows[0]
            b = rows[1]
            c = rows[2]
            low = wp.vec2(wp.min(p[0], wp.min(q[0], r[0])), a[1])
            high = wp.vec2(wp.max(p[0], wp.max(q[0], r[0])), c[1])
            if high[0] >= 0.0 and low[0] <= float(layer.width) and high[1] >= 0.0 and low[1] <= float(layer.height):
                mark(low - edge, high + edge, layer)
                nearest = wp.max(p[2], wp.max(q[2], r[2]))
                farthest = wp.min(p[2], wp.min(q[2], r[2]))
                along_q = wp.vec2(r[1] - p[1], -(r[0] - p[0])) / area  # gradients of the weights of q and r
                along_r = wp.vec2(-(q[1] - p[1]), q[0] - p[0]) / area
                first = colors[face, 0]
                second = colors[face, 1] - first
                third = colors[face, 2] - first
                for row in range(first_center(a[1], layer.height), first_center(c[1], layer.height)):
                    columns = span(row, a, b, c, layer.width)
                    for column in range(columns[0], columns[1]):
                        at = wp.vec2(float(column) + 0.5 - p[0], float(row) + 0.5 - p[1])
                        u = wp.dot(along_q, at)
                        v = wp.dot(along_r, at)
                        near = wp.clamp(p[2] + u * (q[2] - p[2]) + v * (r[2] - p[2]), farthest, nearest)
                        if near > layer.nearness[row, column]:
                            layer.nearness[row, column] = near
                            layer.colors[row, column] = first + u * second + v * third


@wp.kernel
def paint_shadow(places: wp.array2d(dtype=wp.vec3), samples: int, shadow: wp.array2d(dtype=wp.uint8), layer: Layer):
    """Mark the pixels, of `samples` samples a side, in the shadow of triangles, and the tiles up to where their blur ends."""
    scale = 1.0 / float(samples)
    margin = float((BLUR + 1) * samples)
    edge = wp.vec2(margin, margin)
    height = layer.height // samples
    width = layer.width // samples
    for face in range(places.shape[0]):
        p = places[face, 0]
        q = places[face, 1]
        r = places[face, 2]
        if p[2] > 0.0 and q[2] > 0.0 and r[2] > 0.0:
            rows = by_height(scale * p, scale * q, scale * r)
            a = rows[0]
            b = rows[1]
            c = rows[2]
            low = wp.vec2(wp.min(p[0], wp.min(q[0], r[0])), wp.min(p[1], wp.min(q[1], r[1])))
            high = wp.vec2(wp.max(p[0], wp.max(q[0], r[0])), wp.max(p[1], wp.max(q[1], r[1])))
            if high[0] >= 0.0 and low[0] <= float(layer.width) and high[1] >= 0.0 and low[1] <= float(layer.height):
                mark(low - edge, high + edge, layer)
                for row in range(first_center(a[1], height), first_center(c[1], height)):
                    columns = span(row, a, b, c, width)
                    for column in range(columns[0], columns[1]):
                        shadow[row, column] = wp.uint8(1)


@wp.func
def shaded_pixels(row: int, column: int, shadow: wp.array2d(dtype=wp.uint8)) -> int:
    """Return how many of the pixels within reach of the blur above and below one, itself included, are in shadow."""
    count = int(0)
    if column >= 0 and column < shadow.shape[1]:
        for y in range(wp.max(row - BLUR, 0), wp.min(row + BLUR + 1, shadow.shape[0])):
            count += int(shadow[y, column])
    return count


@wp.kernel
def darken(samples: int, darkness: float, shadow: wp.array2d(dtype=wp.uint8), layer: Layer):
    """Darken one tile by the share of the pixels around each one that are in shadow."""
    tile_row, tile_column = wp.tid()
    if layer.tiles[tile_row, tile_column] == wp.uint8(0):
        return
    side = TILE // samples
    bottom = wp.min((tile_row + 1) * side, shadow.shape[0])
    right = wp.min((tile_column + 1) * side, shadow.shape[1])
    most = float((2 * BLUR + 1) * (2 * BLUR + 1))
    for row in range(tile_row * side, bottom):
        count = int(0)
        for column in range(tile_column * side - BLUR - 1, tile_column * side + BLUR):
            count += shaded_pixels(row, column, shadow)
        for column in range(tile_column * side, right):  # one more on the right, one fewer on the left
            count += shaded_pixels(row, column + BLUR, shadow) - shaded_pixels(row, column - BLUR - 1, shadow)
            if count > 0:
                factor = 1.0 - darkness * float(count) / most
                for y in range(row * samples, (row + 1) * samples):
                    for x in range(column * samples, (column + 1) * samples):
                        layer.colors[y, x] = factor * layer.colors[y, x]


@wp.kernel
def draw_edges(step: float, darkness: float, layer: Layer):
    """Darken what lies just behind the edge of something nearer in one tile; the nearness of a plane has no steps."""
    tile_row, tile_column = wp.tid()
    if layer.tiles[tile_row, tile_column] == wp.uint8(0):
        return
    for row in range(wp.max(tile_row * TILE, 1), wp.min((tile_row + 1) * TILE, layer.height - 1)):
        for column in range(wp.max(tile_column * TILE, 1), wp.min((tile_column + 1) * TILE, layer.width - 1)):
            around = layer.nearness[row - 1, column] + layer.nearness[row + 1, column]
            around += layer.nearness[row, column - 1] + layer.nearness[row, column + 1]
            rise = around - 4.0 * layer.nearness[row, column]
            if rise > step:
                strength = darkness * wp.clamp(rise / step - 1.0, 0.0, 1.0)
                layer.colors[row, column] = (1.0 - strength) * layer.colors[row, column]


@wp.kernel
def glaze(alpha: float, hidden_alpha: float, lead: float, ground: wp.array2d(dtype=float), film: Layer, layer: Layer):
    """Lay one tile of a translucent film over what is there, and clear it.

    Where something else than the ground is nearer than the film, or less than `lead` [m] farther, the film counts as hidden.
    """
    tile_row, tile_column = wp.tid()
    if film.tiles[tile_row, tile_column] == wp.uint8(0):
        return
    film.tiles[tile_row, tile_column] = wp.uint8(0)
    layer.tiles[tile_row, tile_column] = wp.uint8(1)
    for row in range(tile_row * TILE, wp.min((tile_row + 1) * TILE, layer.height)):
        for column in range(tile_column * TILE, wp.min((tile_column + 1) * TILE, layer.width)):
            near = film.nearness[row, column]
            if near > 0.0:
                limit = layer.nearness[row, column]
                if limit != ground[row, column]:
                    limit = limit / (1.0 - lead * limit)
                opacity = alpha
                if near < limit:
                    opacity = hidden_alpha
                under = layer.colors[row, column]
                layer.colors[row, column] = under + opacity * (film.colors[row, column] - under)
                film.nearness[row, column] = 0.0


@wp.kernel
def wipe(samples: int, ground: Layer, shadow: wp.array2d(dtype=wp.uint8), layer: Layer):
    """Put the ground back into one tile on which something was drawn."""
    tile_row, tile_column = wp.tid()
    if layer.tiles[tile_row, tile_column] == wp.uint8(0):
        return
    for row in range(tile_row * TILE, wp.min((tile_row + 1) * TILE, layer.height)):
        for column in range(tile_column * TILE, wp.min((tile_column + 1) * TILE, layer.width)):
            layer.nearness[row, column] = ground.nearness[row, column]
            layer.colors[row, column] = ground.colors[row, column]
    side = TILE // samples
    for row in range(tile_row * side, wp.min((tile_row + 1) * side, shadow.shape[0])):
        for column in range(tile_column * side, wp.min((tile_column + 1) * side, shadow.shape[1])):
            shadow[row, column] = wp.uint8(0)


@wp.kernel
def clear_tiles(wiped: wp.array2d(dtype=wp.uint8), layer: Layer):
    """Remember that one tile was wiped since the last picture, and that nothing is drawn on it."""
    row, column = wp.tid()
    if layer.tiles[row, column] != wp.uint8(0):
        wiped[row, column] = wp.uint8(1)
    layer.tiles[row, column] = wp.uint8(0)


@wp.kernel
def resolve(samples: int, wiped: wp.array2d(dtype=wp.uint8), layer: Layer, picture: wp.array3d(dtype=wp.uint8)):
    """Average the samples of each pixel of one tile that was wiped or drawn on."""
    tile_row, tile_column = wp.tid()
    if layer.tiles[tile_row, tile_column] == wp.uint8(0) and wiped[tile_row, tile_column] == wp.uint8(0):
        return
    wiped[tile_row, tile_column] = wp.uint8(0)
    side = TILE // samples
    scale = 255.0 / float(samples * samples)
    for row in range(tile_row * side, wp.min((tile_row + 1) * side, picture.shape[0])):
        for column in range(tile_column * side, wp.min((tile_column + 1) * side, picture.shape[1])):
            light = wp.vec3(0.0, 0.0, 0.0)
            for y in range(row * samples, (row + 1) * samples):
                for x in range(column * samples, (column + 1) * samples):
                    light += layer.colors[y, x]
            for channel in range(3):
                picture[row, column, channel] = wp.uint8(wp.clamp(scale * light[channel] + 0.5, 0.0, 255.0))
