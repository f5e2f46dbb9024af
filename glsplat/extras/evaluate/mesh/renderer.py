"""MeshRenderer: a rigged, textured mesh under the cameras and poses of the splat renderer.

It is the picture that avatars made from the mesh are measured against, and a baseline of its own. Nothing is shared
with the splat path but the frame block, the bone texture's layout and the skinning chunk.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Literal

import moderngl
import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import own
from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.errors import ContextError, GlsplatError
from glsplat.gl.context import Context, create_context
from glsplat.gl.owner import release_later
from glsplat.meshes import RiggedMesh
from glsplat.renderer.checks import checked_pose, checked_views
from glsplat.renderer.frame_block import FrameBlock
from glsplat.renderer.mesh_buffers import INFLUENCES, MeshBuffers
from glsplat.renderer.reach import depth_range, fitted, reach_of
from glsplat.shaders import MeshVariant, Programs, Variant
from glsplat.shaders.slots import UNITS
from glsplat.skinning.pose import Pose
from glsplat.skinning.skin import Skin
from glsplat.timing import StageTimer

__all__ = ["MeshConfig", "MeshRenderer"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshConfig:
    """How finely a mesh is sampled. ``samples * supersample ** 2`` points a pixel decide coverage."""

    samples: Literal[1, 4] = 4  # multisampling; 1 where the driver has none
    supersample: int = 2  # texture samples a pixel and axis: drawn that much larger, then box-filtered
    anisotropy: float = 16.0  # at most what the driver has
    output: Literal["uint8", "float32"] = "uint8"

    def __post_init__(self) -> None:
        if self.samples not in (1, 4):
            raise GlsplatError(f"samples needs 1 or 4, not {self.samples}")
        if not 1 <= self.supersample <= 8:
            raise GlsplatError(f"supersample needs 1 to 8, not {self.supersample}")
        if self.output not in ("uint8", "float32"):
            raise GlsplatError(f"output needs uint8 or float32, not {self.output}")


class MeshRenderer:
    """Renders one mesh for any number of views, one after the other; use and release it on one thread.

    Views are not batched: a layered, multisampled target with a depth buffer is beyond what moderngl can attach.
    """

    mesh: RiggedMesh
    size: tuple[int, int]

    def __init__(
        self,
        mesh: RiggedMesh,
        *,
        size: tuple[int, int] = (1024, 1024),  # width, height
        config: MeshConfig | None = None,
        context: Context | None = None,
        timed: bool = False,  # wait for the GPU at every stage mark
    ) -> None:
        self.config: MeshConfig = config or MeshConfig()
        self.mesh, self.size = mesh, size
        self._owns_context = context is None
        self.context: Context = context or create_context()
        self.context.owner.check("MeshRenderer()")
        self._released = False
        self.timer: StageTimer = StageTimer(self.context.ctx.finish if timed else None)
        self._stack = ExitStack()
        try:
            with self.context.entered("MeshRenderer()"):
                self._open()
            if self._owns_context:
                self.context.owner.leave()  # a new context stays current where none was
        except BaseException:
            self.release()
            raise

    @property
    def driver(self) -> str:
        """Renderer and version strings of the driver."""
        return self.context.driver

    @property
    def timings(self) -> dict[str, float]:
        """Milliseconds a stage of the last frame: pose, draw, resolve, read, total."""
        return self.timer.ms

    @property
    def triangles(self) -> int:
        """Triangles drawn a view."""
        return self._buffers.triangles

    def nbytes(self) -> int:
        """GPU bytes of vertices, triangles and textures."""
        return self._buffers.nbytes

    def render(
        self,
        cameras: Sequence[Camera],
        pose: Pose | None = None,
        *,
        shade: ArrayLike | None = None,  # [N, 3] factors a vertex of the mesh, in linear light (evaluate/light.py)
    ) -> NDArray[Any]:
        """The images [V, H, W, 4], row 0 at the top: RGB over the background, and the share of the pixel covered.

        ``config.output`` decides between uint8 and float32 in [0, 1]. Without ``shade`` colours are the textures'; with
        it what they hold is sRGB, taken to linear light, multiplied and taken back. Raises PoseError for a pose that
        does not fit, GlsplatError for cameras of another size and for a shade that is not one of three finite factors a
        vertex.
        """
        cameras = checked_views(cameras, self.size)
        pose = checked_pose(pose, len(self.mesh.skeleton), "mesh")
        light = None if shade is None else own(shade, np.float32, "shade", GlsplatError)
        if light is not None and not (light.shape == self.mesh.vertices.shape and np.isfinite(light).all()):
            raise GlsplatError(f"shade needs {self.mesh.vertices.shape} finite factors, not {light.shape}")
        if self._released:
            raise GlsplatError("this renderer was released; make a new one")
        with self.context.entered("MeshRenderer.render()"):
            return self._render(cameras, pose, light)

    def release(self) -> None:
        """Delete every GL object, and the context if it was made here. May be called twice."""
        if self._released:
            return
        if not (self.context.released or self.context.owner.forked):
            with self.context.entered("MeshRenderer.release()"):
                self._free()
            if self._owns_context:
                self.context.release()
        self._owns_context, self._released = False, True

    def __enter__(self) -> MeshRenderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def __del__(self) -> None:
        if not getattr(self, "_released", True):
            label = f"a MeshRenderer ({self.size[0]}x{self.size[1]})"
            release_later(label, self.context.owner, self._forget, self._owns_context)

    # ------------------------------------------------------------------------------------------------- internals

    def _open(self) -> None:
        """Make buffers, programs and targets."""
        ctx, size, mesh = self.context.ctx, self.size, self.mesh
        factor = self.config.supersample
        large = (size[0] * factor, size[1] * factor)
        if not 0 < min(size) <= max(large) <= self.context.max_size:
            limit = self.context.max_size // factor
            raise ContextError(f"size needs 1 to {limit} pixels a side on {self.driver}, not {size[0]}x{size[1]}")
        self._programs = self._own(Programs(ctx))
        skin = Skin.create(mesh.joints, mesh.weights, len(mesh.skeleton), INFLUENCES)
        self._reach = reach_of(mesh, skin)
        self._buffers = self._own(MeshBuffers(ctx, mesh, skin, min(self.config.anisotropy, ctx.max_anisotropy)))
        self._frame = self._own(FrameBlock(ctx, 1))
        self._draw_array: moderngl.VertexArray = self._own(self._array(ctx))
        self._shade: moderngl.Buffer | None = None
        self._lit_array: moderngl.VertexArray = self._draw_array
        resolve = self._programs.draw("screen", "mesh_resolve", Variant())
        resolve["factor"] = factor
        self._resolve_array = self._own(ctx.vertex_array(resolve, []))
        self._samples = self.config.samples if ctx.max_samples >= self.config.samples else 1
        self._large = self._own(ctx.texture(large, 4, dtype="f1"))
        depth = self._own(ctx.depth_renderbuffer(large, samples=self._samples if self._samples > 1 else 0))
        if self._samples > 1:
            colour = self._own(ctx.renderbuffer(large, 4, samples=self._samples, dtype="f1"))
            self._drawn = self._own(ctx.framebuffer([colour], depth))
            self._averaged = self._own(ctx.framebuffer([self._large]))
        else:
            self._drawn = self._averaged = self._own(ctx.framebuffer([self._large], depth))
        self._result = self._own(ctx.texture(size, 4, dtype="f1" if self.config.output == "uint8" else "f4"))
        self._final = self._own(ctx.framebuffer([self._result]))

    def _own(self, item: Any) -> Any:
        self._stack.callback(item.release)
        return item

    def _array(self, ctx: moderngl.Context, *more: Any, shaded: int = 0) -> moderngl.VertexArray:
        program = self._programs.draw("mesh", "mesh", MeshVariant(influences=INFLUENCES, shaded=shaded))
        return ctx.vertex_array(program, [self._buffers.content, *more], index_buffer=self._buffers.faces)

    def _shaded(self, shade: NDArray[np.float32]) -> moderngl.VertexArray:
        """What draws under this light; made when it is first asked for."""
        factors = np.ascontiguousarray(shade[self._buffers.indices])
        if self._shade is None:
            self._shade = self._own(self.context.ctx.buffer(reserve=factors.nbytes, dynamic=True))
            self._lit_array = self._own(self._array(self.context.ctx, (self._shade, "3f", "shade"), shaded=1))
        self._shade.write(factors)
        return self._lit_array

    def _fitted(self, camera: Camera, bones: NDArray[np.float64], origin: NDArray[np.float64]) -> Camera:
        """The camera with near and far drawn in to the posed mesh, so that the depth buffer tells layers apart."""
        return fitted(camera, *depth_range(camera, self.mesh.skeleton.joints, self._reach, bones, origin))

    def _render(self, cameras: Sequence[Camera], pose: Pose, shade: NDArray[np.float32] | None) -> NDArray[Any]:
        self.timer.start()
        skeleton = self.mesh.skeleton
        bones = pose.bones(skeleton)
        origin = bones[0, :, :3] @ skeleton.joints[0] + bones[0, :, 3]  # far from zero float32 has no bits left
        bones[:, :, 3] -= origin
        self._buffers.bones.write(bones.astype(np.float32))
        array = self._draw_array if shade is None else self._shaded(shade)
        self.timer.mark("pose")
        out = np.empty((len(cameras), self.size[1], self.size[0], 4), self.config.output)
        for camera, image in zip(cameras, out, strict=True):
            self._draw(array, self._fitted(camera, bones, origin), origin)
            self.timer.mark("draw")
            self._resolve()
            self.timer.mark("resolve")
            self._result.read_into(image)
            self.timer.mark("read")
        self.timer.stop()
        return out

    def _free(self) -> None:
        self.context.scratch.use()  # moderngl restores the framebuffer that was bound, and fails if it is gone
        self._stack.close()

    def _forget(self) -> None:
        """Release what was dropped. A context of its own goes with whoever still holds it."""
        if not self._released and not self.context.released:
            with self.context.entered("MeshRenderer.release()"):
                self._free()
        self._released = True
        if self._owns_context:
            self.context.loosen()

    def _draw(self, array: moderngl.VertexArray, camera: Camera, origin: NDArray[np.float64]) -> None:
        ctx, factor = self.context.ctx, self.config.supersample
        large = camera.resized(camera.width * factor, camera.height * factor)
        self._frame.write([large], large.viewmat, origin, _NO_SPLATS)
        self._drawn.use()
        self._drawn.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        ctx.enable_only(moderngl.DEPTH_TEST)
        self._buffers.draw(ctx, array, self._samples)
        if self._samples > 1:
            ctx.copy_framebuffer(self._averaged, self._drawn)

    def _resolve(self) -> None:
        self._final.use()
        self.context.ctx.enable_only(moderngl.NOTHING)
        self._large.use(UNITS["large"])
        self._resolve_array.render(moderngl.TRIANGLES, vertices=3, instances=1)


_NO_SPLATS = RenderConfig()  # the frame block has room for what only splats need
