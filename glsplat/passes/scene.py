"""SceneBuffers: the splats of one scene on the GPU, staged once, and the bone texture of a skinned one."""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.reference import rigid
from glsplat.shaders.variant import SH_FLOATS, Variant
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

__all__ = ["SceneBuffers"]

Content = list[tuple[object, ...]]
"""What moderngl calls the content of a vertex array: (buffer, format, attribute names...)."""

_NEAR = 16.0  # metres from the origin within which float32 is left alone


class SceneBuffers:
    """Static attributes, SH and skin of one scene. Splats that no camera can ever draw are left out and counted."""

    def __init__(
        self, ctx: moderngl.Context, splats: Splats, skin: Skin | None, joints: int, sh_degree: int, cones: bool
    ) -> None:
        usable = splats.finite() & (np.abs(splats.quats).max(axis=1, initial=0) > 0)
        self.skipped: int = int(len(splats) - usable.sum())
        if self.skipped:
            splats = splats.take(usable)
        self.count: int = len(splats)
        self.sh_degree = sh_degree
        # Far from the world's origin float32 has no bits left for the splats themselves: move them near zero
        self._centre = np.zeros(3)
        if self.count:
            median = np.median(splats.means[:: max(1, self.count // 65536)].astype(np.float64), axis=0)
            self._centre = median if np.abs(median).max() > _NEAR else np.zeros(3)
        self.origin = self._centre
        static = np.empty((self.count, 11), np.float32)
        static[:, :3] = splats.means - self._centre
        static[:, 3] = splats.opacities
        static[:, 4:8] = splats.quats
        static[:, 8:] = splats.scales
        self._static = _buffer(ctx, static)
        self._sh = _buffer(ctx, _packed_sh(splats.sh, sh_degree))
        self._cones = _buffer(ctx, splats.cones) if cones and splats.cones is not None else None
        self._joints: moderngl.Buffer | None = None
        self._weights: moderngl.Buffer | None = None
        self.bones: moderngl.Texture | None = None
        self.shift: float = 1.0
        self.influences: int = 0
        if skin is not None:
            self.influences = skin.influences
            rows = usable if self.skipped else slice(None)
            self._joints = _buffer(ctx, skin.joints[rows])
            self._weights = _buffer(ctx, skin.weights[rows])
            self.bones = ctx.texture((3, joints), 4, dtype="f4")
            self.bones.filter = (moderngl.NEAREST, moderngl.NEAREST)

    @property
    def nbytes(self) -> int:
        """GPU bytes without the SH and the bone texture."""
        buffers = (self._static, self._joints, self._weights, self._cones)
        return sum(b.size for b in buffers if b is not None)

    @property
    def sh_nbytes(self) -> int:
        """GPU bytes of the colour coefficients."""
        return self._sh.size

    def write_bones(self, bones: NDArray[np.float64]) -> None:
        """Upload skinning matrices [J, 3, 4] about the current ``origin``; once a frame."""
        assert self.bones is not None
        self.shift = 1.0 if rigid(bones) else 3.0
        local = bones.copy()
        local[:, :, 3] += bones[:, :, :3] @ self._centre
        # An avatar far away: its root leaves the bones in float64 and comes back with the camera
        root = local[0, :, 3].copy()
        self.origin = root if np.abs(root).max() > _NEAR else np.zeros(3)
        local[:, :, 3] -= self.origin
        self.bones.write(local.astype(np.float32))

    def rigid_content(self) -> Content:
        """Attributes of splat_input.glsl without skinning, and of the skin pass."""
        return [(self._static, "4f 4f 3f", "mean_opacity", "quat", "scale")]

    def cone_content(self) -> Content:
        """The attribute of key.vert.glsl that a variant without cull_hidden does not have."""
        return [(self._cones, "4i1", "cone")] if self._cones is not None else []

    def skin_content(self) -> Content:
        """Attributes of skin.glsl."""
        k = self.influences
        if k == 8:
            return [
                (self._joints, "4u2 4u2", "joints0", "joints1"),
                (self._weights, "4f 4f", "weights0", "weights1"),
            ]
        return [(self._joints, f"{k}u2", "joints0"), (self._weights, f"{k}f", "weights0")]

    def sh_content(self, variant: Variant) -> Content:
        """Attributes of sh.glsl; a variant of a lower degree than the scene's skips the rest of each row."""
        rest = (SH_FLOATS[self.sh_degree] - SH_FLOATS[variant.sh_degree]) * 4
        skip = f" {rest}x" if rest else ""
        if variant.sh_degree == 0:
            return [(self._sh, "3f" + skip, "sh0")]
        count = SH_FLOATS[variant.sh_degree] // 4
        return [(self._sh, " ".join(["4f"] * count) + skip, *(f"sh{i}" for i in range(count)))]

    def release(self) -> None:
        """Delete all buffers and the bone texture."""
        for item in (self._static, self._sh, self._cones, self._joints, self._weights, self.bones):
            if item is not None:
                item.release()


def _packed_sh(sh: NDArray[np.float32], degree: int) -> NDArray[np.float32]:
    """[N, SH_FLOATS[degree]] coefficients up to ``degree``, rgb after rgb, padded to whole vec4s."""
    used = (degree + 1) ** 2
    flat = sh[:, :used].reshape(len(sh), used * 3)
    missing = SH_FLOATS[degree] - flat.shape[1]
    return np.pad(flat, ((0, 0), (0, missing))) if missing else flat


def _buffer(ctx: moderngl.Context, array: NDArray[np.generic]) -> moderngl.Buffer:
    # OpenGL has no empty buffers; a scene of no splats keeps one byte it never reads
    return ctx.buffer(np.ascontiguousarray(array)) if array.size else ctx.buffer(reserve=16)
