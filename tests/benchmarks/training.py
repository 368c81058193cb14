# SPDX-License-Identifier: GPL-3.0-or-later
"""Shapes to train on, made here: bodies with facets, creases, fillets and thin parts.

Every shape is a triangle mesh, a smooth surface or a union of solids, sampled evenly by
area; the truth is the normal of the triangle, surface or solid that a point lies on, as
in the PCPNet protocol.
"""

import numpy as np
from scipy.spatial import ConvexHull


def sample_mesh(vertices, faces, count, rng):
    """Return points and normals drawn evenly from the triangles of a mesh."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    at = rng.choice(len(faces), count, p=area / area.sum())
    s, t = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    points = a[at] * (1 - s) + b[at] * s * (1 - t) + c[at] * s * t
    return points, cross[at] / area[at, None]


def rotation(rng):
    """Return a random rotation, (3, 3)."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.diag(r))


def _directions(count, rng):
    d = rng.normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def _rough(directions, rng, octaves, strength):
    """Return sums of waves that get finer and lower."""
    height = np.zeros(len(directions))
    for octave in range(octaves):
        waves = rng.normal(size=(6, 3)) * 2.0**octave * 1.5
        phase = rng.uniform(0, 2 * np.pi, 6)
        wave = np.sin(directions @ waves.T + phase).mean(axis=1)
        if rng.random() < 0.25:
            wave = np.abs(wave)
        height += strength * 0.55**octave * wave
    return height


def blob(rng):
    """Return a mesh of a body with bumps, folds and facets of any fineness."""
    count = int(np.exp(rng.uniform(np.log(400), np.log(30000))))
    directions = _directions(count, rng)
    for _ in range(3):
        # Triangles alike in size: points move away from their neighbors.
        faces = ConvexHull(directions).simplices
        total, number = np.zeros((count, 3)), np.zeros(count)
        for i, j in ((0, 1), (1, 2), (2, 0), (1, 0), (2, 1), (0, 2)):
            np.add.at(total, faces[:, i], directions[faces[:, j]])
            np.add.at(number, faces[:, i], 1)
        directions = total / number[:, None]
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    faces = ConvexHull(directions).simplices
    radius = np.exp(_rough(directions, rng, rng.integers(2, 7), rng.uniform(0.2, 0.9)))
    for _ in range(rng.integers(0, 5)):
        axis = _directions(1, rng)[0]
        if rng.random() < 0.5:
            # A limb.
            sharp = rng.uniform(8, 60)
            radius *= 1 + rng.uniform(0.5, 2) * np.exp(sharp * (directions @ axis - 1))
        else:
            # A flat cut, with a crease around it.
            along = np.maximum(directions @ axis, 1e-3)
            radius = np.minimum(radius, rng.uniform(0.5, 1.1) / along)
    stretch = rng.uniform(0.35, 1, 3)
    vertices = directions * radius[:, None] * stretch
    jitter = rng.choice([0, 0, 0.03, 0.1]) / np.sqrt(count)
    return vertices + rng.normal(0, jitter, vertices.shape), faces


def extrusion(rng):
    """Return a mesh of a profile with corners and arcs, pulled along z."""
    corners = rng.integers(3, 12)
    angle = np.sort(rng.uniform(0, 2 * np.pi, corners))
    radius = rng.uniform(0.4, 1, corners)
    turn = np.linspace(
        0, 2 * np.pi, rng.choice([corners * 4, 120, 300]), endpoint=False
    )
    knots = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    profile = np.stack(
        [np.interp(turn, angle, knots[:, i], period=2 * np.pi) for i in range(2)],
        axis=1,
    )
    if rng.random() < 0.5:
        # Arcs instead of corners.
        width = rng.integers(2, 10)
        kernel = np.ones(width) / width
        wrapped = np.concatenate([profile[-width:], profile, profile[:width]])
        for i in range(2):
            smooth = np.convolve(wrapped[:, i], kernel, "same")[width:-width]
            profile[:, i] = smooth
    layers = rng.choice([2, 2, 5, 30])
    z = np.linspace(0, 1, layers) * rng.uniform(0.1, 1.5)
    taper = 1 + rng.uniform(-0.5, 0.5) * np.linspace(0, 1, layers)
    if layers > 5:
        taper += 0.2 * np.sin(np.linspace(0, rng.uniform(2, 9), layers))
    rings = np.concatenate(
        [
            np.concatenate([profile * s, np.full((len(profile), 1), h)], axis=1)
            for s, h in zip(taper, z, strict=True)
        ]
    )
    return _capped(rings, len(profile), layers)


def lathe(rng):
    """Return a mesh of a profile turned around z, with steps and roundings."""
    around = rng.integers(16, 160)
    heights = rng.integers(4, 10)
    radius = rng.uniform(0.25, 1, heights)
    z = np.sort(rng.uniform(-1, 1, heights)) * rng.uniform(0.3, 1.2)
    if rng.random() < 0.5:
        radius = np.repeat(radius, 2)
        z = np.concatenate([z[:1], np.repeat(z[1:], 2), z[-1:] + 0.2])
    if rng.random() < 0.4:
        fine = np.linspace(0, 1, 60)
        places = np.linspace(0, 1, len(z))
        radius, z = np.interp(fine, places, radius), np.interp(fine, places, z)
        radius = np.convolve(np.pad(radius, 3, "edge"), np.ones(7) / 7, "valid")
    turn = np.linspace(0, 2 * np.pi, around, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    rings = np.concatenate(
        [
            np.concatenate([circle * r, np.full((around, 1), h)], axis=1)
            for r, h in zip(radius, z, strict=True)
        ]
    )
    return _capped(rings, around, len(z))


def _capped(rings, around, layers):
    """Join rings of vertices to a body closed by fans."""
    i = np.arange(around)
    after = (i + 1) % around
    faces = []
    for layer in range(layers - 1):
        a, b = layer * around, (layer + 1) * around
        faces.append(np.stack([a + i, a + after, b + i], axis=1))
        faces.append(np.stack([a + after, b + after, b + i], axis=1))
    ends = np.stack([rings[:around].mean(axis=0), rings[-around:].mean(axis=0)])
    bottom, top = len(rings), len(rings) + 1
    last = (layers - 1) * around
    faces.append(np.stack([np.full(around, bottom), after, i], axis=1))
    faces.append(np.stack([np.full(around, top), last + i, last + after], axis=1))
    return np.concatenate([rings, ends]), np.concatenate(faces)


def tube(rng):
    """Return a mesh of a thin tube around a closed curve."""
    along, around = rng.integers(80, 500), rng.integers(8, 48)
    turn = np.linspace(0, 2 * np.pi, along, endpoint=False)
    curve = np.zeros((along, 3))
    for wave in (1, 2, 3):
        phase = rng.uniform(0, 2 * np.pi, 3)
        curve += rng.normal(0, 1 / wave**1.5, 3) * np.sin(wave * turn[:, None] + phase)
    tangent = np.roll(curve, -1, axis=0) - np.roll(curve, 1, axis=0)
    side = np.cross(tangent, _directions(1, rng)[0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(tangent, side)
    other /= np.linalg.norm(other, axis=1, keepdims=True)
    radius = rng.uniform(0.06, 0.3) * (1 + rng.uniform(0, 0.5) * np.sin(turn * 3))
    flat = rng.uniform(0.3, 1)
    v = np.linspace(0, 2 * np.pi, around, endpoint=False)
    rings = curve[:, None] + radius[:, None, None] * (
        np.cos(v)[:, None] * side[:, None] + flat * np.sin(v)[:, None] * other[:, None]
    )
    i, j = np.meshgrid(np.arange(along), np.arange(around), indexing="ij")
    right, up = (i + 1) % along, (j + 1) % around
    a, b, c, d = (
        (p * around + q).ravel() for p, q in ((i, j), (right, j), (right, up), (i, up))
    )
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return rings.reshape(-1, 3), faces


class Box:
    """A solid box; thin or not."""

    def __init__(self, rng):
        self.half = np.exp(rng.uniform(np.log(0.06), np.log(0.7), 3))

    def inside(self, p):
        return (np.abs(p) < self.half).all(axis=1)

    def area(self):
        a, b, c = self.half
        return 8 * (a * b + b * c + c * a)

    def sample(self, count, rng):
        a, b, c = self.half
        sides = np.array([b * c, c * a, a * b])
        axis = rng.choice(3, count, p=sides / sides.sum())
        points = rng.uniform(-1, 1, (count, 3)) * self.half
        sign = rng.choice([-1.0, 1.0], count)
        normals = np.zeros((count, 3))
        normals[np.arange(count), axis] = sign
        points[np.arange(count), axis] = sign * self.half[axis]
        return points, normals


class Cylinder:
    """A solid cylinder or cone along z."""

    def __init__(self, rng):
        self.radius = np.exp(rng.uniform(np.log(0.06), np.log(0.6)))
        self.half = np.exp(rng.uniform(np.log(0.06), np.log(0.9)))

    def inside(self, p):
        flat = np.hypot(p[:, 0], p[:, 1]) < self.radius
        return flat & (np.abs(p[:, 2]) < self.half)

    def area(self):
        return 2 * np.pi * self.radius * (self.radius + 2 * self.half)

    def sample(self, count, rng):
        turn = rng.uniform(0, 2 * np.pi, count)
        circle = np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=1)
        cap = rng.random(count) < self.radius / (self.radius + 2 * self.half)
        r = np.where(cap, np.sqrt(rng.random(count)), 1) * self.radius
        sign = rng.choice([-1.0, 1.0], count)
        points = circle * r[:, None]
        points[:, 2] = np.where(cap, sign, rng.uniform(-1, 1, count)) * self.half
        normals = np.where(cap[:, None], sign[:, None] * [0, 0, 1], circle)
        return points, normals


class Ball:
    """A solid ball."""

    def __init__(self, rng):
        self.radius = rng.uniform(0.1, 0.6)

    def inside(self, p):
        return (p * p).sum(axis=1) < self.radius**2

    def area(self):
        return 4 * np.pi * self.radius**2

    def sample(self, count, rng):
        normals = _directions(count, rng)
        return normals * self.radius, normals


class Solids:
    """Boxes, cylinders and balls joined, and holes drilled into them."""

    def __init__(self, rng):
        aligned = rng.random() < 0.5
        self.parts = []
        for i in range(rng.integers(2, 9)):
            kind = (Box, Box, Cylinder, Ball)[rng.integers(4)]
            turn = np.eye(3) if aligned else rotation(rng)
            where = rng.uniform(-0.6, 0.6, 3) * (i > 0)
            drilled = i > 1 and rng.random() < 0.3
            self.parts.append((kind(rng), turn, where, drilled))

    def sample(self, count, rng):
        areas = np.array([part.area() for part, *_ in self.parts])
        points, normals = [], []
        found = 0
        while found < count:
            for i, (part, turn, where, drilled) in enumerate(self.parts):
                p, n = part.sample(int(count * areas[i] / areas.sum()) + 1, rng)
                p, n = p @ turn.T + where, n @ turn.T
                kept = self._visible(p, i, drilled)
                points.append(p[kept])
                normals.append(-n[kept] if drilled else n[kept])
                found += kept.sum()
        points, normals = np.concatenate(points), np.concatenate(normals)
        chosen = rng.choice(len(points), count, replace=False)
        return points[chosen], normals[chosen]

    def _visible(self, points, own, drilled):
        """Whether points of a part lie on the boundary of the whole."""
        solid = np.zeros(len(points), dtype=bool)
        hole = np.zeros(len(points), dtype=bool)
        for i, (part, turn, where, drills) in enumerate(self.parts):
            if i != own:
                inside = part.inside((points - where) @ turn)
                if drills:
                    hole |= inside
                else:
                    solid |= inside
        return (solid if drilled else ~solid) & ~hole


def _ball(rng):
    """Return a smooth bumpy body as a function of two parameters."""
    octaves = rng.integers(1, 5)
    waves = [rng.normal(size=(6, 3)) * 2.0**octave for octave in range(octaves)]
    phases = rng.uniform(0, 2 * np.pi, (octaves, 6))
    strength = rng.uniform(0, 0.8)
    stretch = rng.uniform(0.35, 1, 3)

    def surface(at):
        z, turn = 2 * at[:, 0] - 1, 2 * np.pi * at[:, 1]
        flat = np.sqrt(1 - z * z)
        directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
        height = sum(
            0.5**octave * np.sin(directions @ wave.T + phase).mean(axis=1)
            for octave, (wave, phase) in enumerate(zip(waves, phases, strict=True))
        )
        return directions * np.exp(strength * height)[:, None] * stretch

    return surface


def _ring(rng):
    """Return a smooth thin tube around a closed curve, which may cross itself."""
    # Nearly level, so that the curve never runs along the z axis.
    amplitude = rng.normal(0, 1, (3, 3)) / np.array([1, 2, 3])[:, None] ** 2
    amplitude *= [1, 1, 0.3]
    phase = rng.uniform(0, 2 * np.pi, (3, 3))
    radius, bulge = rng.uniform(0.1, 0.4), rng.uniform(0, 0.5)
    flat = rng.uniform(0.4, 1)

    def surface(at):
        turn, v = 2 * np.pi * at.T[:, :, None]
        waves = np.arange(1, 4)
        angle = waves[:, None] * turn[:, None] + phase
        curve = (amplitude * np.sin(angle)).sum(axis=1)
        tangent = (waves[:, None] * amplitude * np.cos(angle)).sum(axis=1)
        side = np.cross(tangent, [0.0, 0.0, 1.0])
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        other = np.cross(tangent, side)
        other /= np.linalg.norm(other, axis=1, keepdims=True)
        wide = radius * (1 + bulge * np.sin(3 * turn))
        return curve + wide * (np.cos(v) * side + flat * np.sin(v) * other)

    return surface


class Smooth:
    """A surface without facets or creases, known exactly."""

    def __init__(self, rng):
        self.surface = (_ball, _ball, _ring)[rng.integers(3)](rng)

    def sample(self, count, rng):
        # Differences reach beyond both ends.
        at = 0.0001 + 0.9998 * rng.random((4 * count, 2))
        along = [
            self.surface(at + step) - self.surface(at - step)
            for step in 1e-5 * np.eye(2)
        ]
        cross = np.cross(*along)
        area = np.linalg.norm(cross, axis=1)
        kept = rng.choice(len(at), count, replace=False, p=area / area.sum())
        return self.surface(at[kept]), cross[kept] / area[kept, None]


MESHES = (blob, blob, extrusion, lathe, tube)


def shape(seed):
    """Return a function (count, rng) -> points, normals of the shape of a seed."""
    rng = np.random.default_rng([seed, 1])
    turn = rotation(rng)
    if seed % 3 == 2:
        draw = Solids(rng).sample
    elif seed % 6 == 4:
        draw = Smooth(rng).sample
    else:
        vertices, faces = MESHES[rng.integers(len(MESHES))](rng)
        draw = lambda count, rng: sample_mesh(vertices, faces, count, rng)  # noqa: E731

    def turned(count, rng):
        points, normals = draw(count, rng)
        return points @ turn.T, normals @ turn.T

    return turned
