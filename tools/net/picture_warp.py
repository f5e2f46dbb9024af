"""A picture put where another eye sees it, by a mesh of points whose distances are known, as the page does it."""

from __future__ import annotations

from typing import Any, NamedTuple

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.gl.context import create_context
from glsplat.rotations import FLIP_YZ

F64 = NDArray[np.float64]
Image = NDArray[np.uint8]
Points = tuple[F64, F64, F64]
"""Columns, rows (parts of the picture) and camera z [rows, columns] in metres."""

_VERTEX = """#version 330
in vec4 place; in vec2 at; uniform mat4 clip_from_camera; out vec2 uv;
void main() { uv = at; gl_Position = clip_from_camera * place; }"""
_FRAGMENT = """#version 330
uniform sampler2D picture; uniform vec2 range; in vec2 uv; out vec4 result;
void main() { result = texture(picture, uv); if (result.a < range.x || result.a >= range.y) discard; }"""


class View(NamedTuple):
    """An eye and the part of its sight that a picture shows."""

    eye: F64  # [4, 4] world from eye, OpenXR axes
    left: float  # tangents
    right: float
    down: float
    up: float

    def rays(self, u: F64, v: F64) -> F64:
        """[..., 3] in the eye's axes, as long as -z is 1."""
        x, y = self.left + u * (self.right - self.left), self.up - v * (self.up - self.down)
        return np.stack([x, y, np.full_like(x, -1)], axis=-1)

    def camera(self, width: int, height: int) -> Camera:
        fx, fy = width / (self.right - self.left), height / (self.up - self.down)
        k = np.array([[fx, 0, -self.left * fx], [0, fy, self.up * fy], [0, 0, 1]])
        return Camera(FLIP_YZ @ np.linalg.inv(self.eye), k, width, height)


class Warper:
    """Puts pictures back, by OpenGL as the page does by WebGL."""

    def __init__(self) -> None:
        self._context = create_context()
        self._gl = self._context.ctx
        self._program: Any = self._gl.program(_VERTEX, _FRAGMENT)

    def __call__(self, image: Image, view: View, points: Points, seen: View, size: tuple[int, int]) -> Image:
        """``image`` [H, W, 4], asked for ``view``, as ``seen`` sees it."""
        gl, (u, v, z) = self._gl, points
        uu, vv = np.meshgrid(u, v)
        data = np.concatenate([view.rays(uu, vv), 1 / z[..., None], uu[..., None], vv[..., None]], axis=-1)
        index = np.arange(z.size).reshape(z.shape)
        a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
        clip = _projection(seen) @ np.linalg.inv(seen.eye) @ view.eye
        texture = gl.texture((image.shape[1], image.shape[0]), 4, image.tobytes())
        texture.repeat_x = texture.repeat_y = False
        target = gl.framebuffer([gl.texture(size, 4)], gl.depth_renderbuffer(size))
        target.use()
        target.clear()
        texture.use(0)
        self._program["clip_from_camera"].write(clip.T.astype("f4").tobytes())
        points_of = gl.buffer(data.astype("f4").tobytes())
        corners = gl.buffer(np.stack([a, b, c, b, d, c], axis=-1).astype("i4").tobytes())
        mesh = gl.vertex_array(self._program, [(points_of, "4f 2f", "place", "at")], corners)
        gl.enable(moderngl.DEPTH_TEST | moderngl.BLEND)
        gl.blend_func = moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA
        for least, most in ((0.5, 2), (1e-6, 0.5)):
            self._program["range"] = least, most
            target.depth_mask = most > 1
            mesh.render(moderngl.TRIANGLES)
        target.depth_mask = True
        out = np.frombuffer(target.read(components=4), np.uint8).reshape(size[1], size[0], 4)[::-1].copy()
        for one in (mesh, points_of, corners, texture, *target.color_attachments, target):
            one.release()
        return out


def _projection(view: View, near: float = 0.02, far: float = 100.0) -> F64:
    wide, high = view.right - view.left, view.up - view.down
    out = np.zeros((4, 4))
    out[0, [0, 2]] = 2 / wide, (view.right + view.left) / wide
    out[1, [1, 2]] = 2 / high, (view.up + view.down) / high
    out[2, 2:], out[3, 2] = (-(far + near) / (far - near), -2 * far * near / (far - near)), -1
    return out
