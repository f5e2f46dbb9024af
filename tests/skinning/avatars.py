"""Avatars for the skinning tests, and the comparison of a skin pass with its float64 twin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.meshes import RiggedMesh
from glsplat.renderer import Renderer
from glsplat.rotations import is_rigid, rotation_matrices
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats
from tests.scenes import camera

VIEW = camera(1)
"""One pixel: the skin pass runs over all splats and the rest of the frame costs nothing."""


@dataclass(frozen=True)
class SkinError:
    """The skin pass of one pose against reference.skin."""

    position: float  # metres
    covariance: float  # largest relative Frobenius error; three tenths of it near a collapse (length of P v)
    orthonormal: float  # largest entry of R R^T - I
    determinant: float  # smallest det R

    @classmethod
    def of(cls, renderer: Renderer, avatar: Avatar, pose: Pose, rotation: str = "polar") -> SkinError:
        renderer.render([VIEW], pose)
        means, shapes = renderer.posed()
        assert np.isfinite(means).all() and np.isfinite(shapes).all()
        expected = reference.skin(avatar.splats, avatar.skin, pose.bones(avatar.skeleton), rotation)
        sigma, wanted = covariances(shapes), covariances(expected.shapes)
        scale = np.maximum(np.linalg.norm(wanted, axis=(1, 2)), 1e-300)
        bones = pose.bones(avatar.skeleton)
        blended = np.einsum("nk,nkij->nij", avatar.skin.weights.astype(np.float64), bones[avatar.skin.joints])
        shift = 1.0 if is_rigid(bones) else 3.0
        swing = reference._swing(blended[:, :, :3], bones[avatar.skin.joints[:, 0], :, :3], shift)[0]
        steady = np.linalg.norm(swing, axis=1)  # float32 divides by it
        turned = rotations(avatar.splats, shapes)
        gram = turned @ np.swapaxes(turned, 1, 2)
        return cls(
            float(np.abs(means - expected.means).max()),
            float((np.linalg.norm(sigma - wanted, axis=(1, 2)) / scale * np.clip(100 * steady, 0.3, 1)).max()),
            float(np.abs(gram - np.eye(3)).max()),
            float(np.linalg.det(turned).min()),
        )

    def within(self, position: float = 1e-5, covariance: float = 5e-5, orthonormal: float = 1e-5) -> bool:
        exact = self.position <= position and self.covariance <= covariance
        return exact and self.orthonormal <= orthonormal and self.determinant > 0.9


def covariances(shapes: NDArray[np.floating]) -> NDArray[np.float64]:
    """Sigma [N, 3, 3] of shapes M."""
    m = shapes.astype(np.float64)
    return m @ np.swapaxes(m, 1, 2)


def rotations(splats: Splats, shapes: NDArray[np.floating]) -> NDArray[np.float64]:
    """R_i [N, 3, 3]: what took M0 = R(q) diag(s) to ``shapes``."""
    return (shapes / splats.scales.astype(np.float64)[:, None, :]) @ np.swapaxes(
        reference.quaternion_matrices(splats.quats), 1, 2
    )


def turn(a: NDArray[np.floating], b: NDArray[np.floating]) -> NDArray[np.float64]:
    """[N] degrees between rotations [N, 3, 3]."""
    chord = np.linalg.norm(a - b, axis=(1, 2)) / np.sqrt(8)  # the sine of half the angle: exact where it is small
    return np.degrees(2 * np.arcsin(np.clip(chord, 0, 1)))


def blended_part(avatar: Avatar, count: int, seed: int = 0) -> Avatar:
    """``count`` splats of an avatar: three quarters are those that ride several joints most evenly, the rest any."""
    rng = np.random.default_rng(seed)
    strongest = avatar.skin.weights.max(axis=1)
    even = np.argsort(strongest, kind="stable")[: 4 * count]
    index = np.union1d(rng.choice(even, 3 * count // 4, replace=False), rng.choice(len(strongest), count // 4))
    return part(avatar, index)


def part(avatar: Avatar, index: NDArray[np.intp]) -> Avatar:
    """The splats at ``index`` with their skin."""
    skin = Skin(avatar.skin.joints[index], avatar.skin.weights[index])
    return Avatar(avatar.splats.take(index), avatar.skeleton, skin)


def person_avatar(mesh: RiggedMesh, seed: int = 0) -> Avatar:
    """One splat a vertex, of any shape: for skinning, not for looking at."""
    rng = np.random.default_rng(seed)
    count = len(mesh.vertices)
    scales = np.exp(rng.uniform(-8, -4.5, (count, 3)))
    colours = rng.random((count, 3))
    splats = Splats.create(mesh.vertices, rng.normal(size=(count, 4)), scales, rng.uniform(0.3, 1, count), rgb=colours)
    return Avatar(splats, mesh.skeleton, Skin.create(mesh.joints, mesh.weights, len(mesh.skeleton)))


def chain(count: int, joints: int, influences: int = 4, step: float = 0.05, seed: int = 5) -> Avatar:
    """Splats around a chain of joints along x, each bound to the joints nearby with random weights."""
    rng = np.random.default_rng(seed)
    skeleton = Skeleton.from_joints(
        tuple(f"joint{i}" for i in range(joints)),
        np.arange(joints) - 1,
        np.stack([step * np.arange(joints), np.zeros(joints), np.zeros(joints)], -1),
    )
    first = rng.integers(0, joints, count)
    ids = (first[:, None] + np.arange(influences)) % joints
    means = np.stack([step * first, *rng.normal(0, 0.05, (2, count))], -1)
    scales = np.exp(rng.uniform(-8, -4, (count, 3)))
    colours = rng.random((count, 3))
    splats = Splats.create(means, rng.normal(size=(count, 4)), scales, rng.uniform(0.3, 1, count), rgb=colours)
    return Avatar(splats, skeleton, Skin.create(ids, rng.random(ids.shape) + 0.01, joints, influences))


def any_rotations(rng: np.random.Generator, joints: int) -> NDArray[np.float64]:
    """[J, 3] axis-angle of rotations drawn evenly from all rotations."""
    quats = rng.normal(size=(joints, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    quats *= np.where(quats[:, :1] < 0, -1, 1)
    sine = np.linalg.norm(quats[:, 1:], axis=1, keepdims=True)
    vectors = quats[:, 1:] / np.maximum(sine, 1e-12) * 2 * np.arctan2(sine, quats[:, :1])
    assert np.allclose(rotation_matrices(vectors), reference.quaternion_matrices(quats), atol=1e-9)
    return vectors
