"""What fits splats to pictures projects them as the contract does, needles included."""

from __future__ import annotations

import numpy as np

from glsplat import reference
from glsplat.authoring.footprints import footprints
from glsplat.camera import Camera, look_at, pinhole
from tests.scenes import cloud


def test_the_projection_is_that_of_the_contract() -> None:
    splats = cloud(400)
    camera = Camera(look_at((0.3, 1, 3), (0, 0, 0)), pinhole(96, 64), 96, 64)
    scales, rotations = splats.scales.astype(np.float64), reference.quaternion_matrices(splats.quats)
    prints = footprints(splats.means.astype(np.float64), rotations, scales, splats.opacities.astype(np.float64), camera)
    a, b, c = reference.project(reference.rest(splats), splats, camera).covars2d.T
    expected = np.stack([c, -b, a], axis=1) / (a * c - b * b)[:, None]
    np.testing.assert_allclose(prints.conic, expected, rtol=1e-9, atol=1e-12)


def test_needles_keep_their_width() -> None:
    """1e11:1 in the plane of the picture: the determinant by a c - b^2 is 0 or negative here, in float64 too."""
    count = 200
    angles = np.linspace(0, np.pi, count)
    quats = np.stack([np.cos(angles / 2), 0 * angles, 0 * angles, np.sin(angles / 2)], -1)
    camera = Camera(look_at((0, 0, 3), (0, 0, 0)), np.array([[1000.0, 0, 500], [0, 1000, 500], [0, 0, 1]]), 1000, 1000)
    scales = np.tile([1e6, 1e-5, 1e-5], (count, 1))
    faint = np.full(count, 1e-9)  # nothing is drawn, only projected
    prints = footprints(np.zeros((count, 3)), reference.quaternion_matrices(quats), scales, faint, camera)
    a, _, c = prints.conic.T
    np.testing.assert_allclose(1 / (a + c), 0.3 + (1000 / 3 * 1e-5) ** 2, rtol=1e-6)  # the smaller variance, px^2
