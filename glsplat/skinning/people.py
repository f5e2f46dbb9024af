"""People: rigged, textured meshes, and the reader of the person archives (.npz)."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError, PoseError
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton

__all__ = ["MeshPart", "RiggedMesh", "decode_texture", "read_person"]

_NEEDED = ("vertices", "joints", "parents", "joint_names", "skin_indices", "skin_weights", "part_names")


@dataclass(frozen=True, slots=True, eq=False)
class MeshPart:
    """The triangles that share one texture."""

    name: str
    faces: NDArray[np.int32]  # [F, 3] vertex indices
    uv: NDArray[np.float64]  # [F, 3, 2] a texture coordinate a corner, v axis up, repeats outside [0, 1]
    texture: NDArray[np.uint8]  # [H, W, 4] RGBA, row 0 is v = 1

    @property
    def cutout(self) -> bool:
        """True where texels of alpha below one half cut holes (hair, brows, lashes)."""
        return bool((self.texture[..., 3] < 128).any())

    def sample(self, uv: NDArray[np.float64], *, nearest: bool = False) -> NDArray[np.float64]:
        """RGBA in [0, 1] at texture coordinates [..., 2]: bilinear, texel centres at +0.5."""
        height, width = self.texture.shape[:2]
        x = uv[..., 0] % 1.0 * width - 0.5
        y = (1.0 - uv[..., 1] % 1.0) * height - 0.5
        if nearest:
            return self.texture[np.rint(y).astype(int) % height, np.rint(x).astype(int) % width] / 255.0
        x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
        fx, fy = (x - x0)[..., None], (y - y0)[..., None]
        x1, y1 = np.clip(x0 + 1, 0, width - 1), np.clip(y0 + 1, 0, height - 1)
        x0, y0 = np.clip(x0, 0, width - 1), np.clip(y0, 0, height - 1)
        t = self.texture
        top = t[y0, x0] * (1 - fx) + t[y0, x1] * fx
        return (top * (1 - fy) + (t[y1, x0] * (1 - fx) + t[y1, x1] * fx) * fy) / 255.0


@dataclass(frozen=True, slots=True, eq=False)
class RiggedMesh:
    """A person in the zero pose: vertices, the rig that moves them, textured parts."""

    vertices: NDArray[np.float64]  # [V, 3] metres, y up, facing +z
    skeleton: Skeleton
    joints: NDArray[np.int64]  # [V, K] joints of each vertex
    weights: NDArray[np.float64]  # [V, K] >= 0
    parts: tuple[MeshPart, ...]
    meta: Mapping[str, Any] = field(default_factory=dict)  # source, licence, ... (what the file says)

    def __post_init__(self) -> None:
        count = len(self.vertices)
        if self.vertices.shape != (count, 3) or not np.isfinite(self.vertices).all():
            raise FormatError(f"a mesh needs finite vertices (V, 3), not {self.vertices.shape}")
        if self.joints.shape != self.weights.shape or self.joints.shape[:1] != (count,) or self.joints.ndim != 2:
            raise FormatError(f"a mesh of {count} vertices needs joints and weights ({count}, K)")
        if self.joints.size and not 0 <= self.joints.min() <= self.joints.max() < len(self.skeleton):
            raise FormatError(f"a vertex is bound to joint {self.joints.max()} of {len(self.skeleton)}")
        if not self.parts or not sum(len(part.faces) for part in self.parts):
            raise FormatError("a mesh needs at least one triangle")
        for part in self.parts:
            if part.faces.size and not 0 <= part.faces.min() <= part.faces.max() < count:
                raise FormatError(f'part "{part.name}" names vertex {part.faces.max()} of {count}')
            if part.uv.shape != (*part.faces.shape, 2):
                raise FormatError(f'part "{part.name}" needs uv {(*part.faces.shape, 2)}, not {part.uv.shape}')

    @property
    def faces(self) -> NDArray[np.int32]:
        """[F, 3] the triangles of all parts, in order."""
        return np.concatenate([part.faces for part in self.parts])

    @property
    def face_parts(self) -> NDArray[np.intp]:
        """[F] index of each triangle's part."""
        return np.repeat(np.arange(len(self.parts)), [len(part.faces) for part in self.parts])

    def posed(self, pose: Pose) -> NDArray[np.float64]:
        """[V, 3] vertices under linear blend skinning."""
        bones = pose.bones(self.skeleton)
        total = self.weights.sum(axis=1, keepdims=True)
        blended = np.einsum("vk,vkij->vij", self.weights / np.where(total > 0, total, 1), bones[self.joints])
        return np.einsum("vij,vj->vi", blended[:, :, :3], self.vertices) + blended[:, :, 3]


def decode_texture(data: bytes | NDArray[np.uint8], where: str) -> NDArray[np.uint8]:
    """RGBA uint8 [H, W, 4] of a JPEG or PNG; FormatError naming ``where`` if it is neither."""
    buffer = np.frombuffer(data, np.uint8) if isinstance(data, bytes) else data
    image = cv2.imdecode(buffer, cv2.IMREAD_UNCHANGED) if buffer.size else None
    if image is None:
        raise FormatError(f"{where}: a texture is a JPEG or PNG, found {bytes(buffer[:4])!r}")
    if image.dtype != np.uint8:
        image = (image / 257).astype(np.uint8)
    if image.ndim == 2:
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGBA if image.shape[2] == 3 else cv2.COLOR_BGRA2RGBA)


def read_person(path: str | Path) -> RiggedMesh:
    """Read a person archive: an .npz of a rigged mesh with textured parts.

    Keys: vertices (V, 3) metres, joints (J, 3) rest positions with frames parallel to the world, parents (J,),
    joint_names (J,), skin_indices and skin_weights (V, K), part_names (P,), and for part i: faces_i, faces_uv_i (F, 3),
    uv_i (T, 2) with v up, texture_i (bytes of a JPEG or PNG). Raises FormatError naming the file and the key.
    """
    try:
        with open(path, "rb") as file:
            if file.read(2) != b"PK":
                raise FormatError(f"{path}: a person is an .npz archive, but this is none")
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                data = {key: np.asarray(archive[key]) for key in archive.files}
    except OSError as error:
        raise FormatError(f"{path}: cannot read the person ({error.strerror or error})") from None
    except (ValueError, EOFError, zipfile.BadZipFile) as error:
        raise FormatError(f"{path}: a person is an .npz archive, but {error}") from None
    count = len(data.get("part_names", ()))
    needed = [*_NEEDED, *(f"{key}_{i}" for i in range(count) for key in ("faces", "faces_uv", "uv", "texture"))]
    missing = [key for key in needed if key not in data]
    if missing:
        raise FormatError(f"{path}: a person needs the key {missing[0]}; found {', '.join(list(data)[:8])}")
    try:
        skeleton = Skeleton.from_joints(tuple(map(str, data["joint_names"])), data["parents"], data["joints"])
        parts = tuple(_part(data, i, str(name), str(path)) for i, name in enumerate(data["part_names"]))
        meta = {"source": Path(path).name}
        indices, weights = data["skin_indices"].astype(np.int64), data["skin_weights"].astype(np.float64)
        return RiggedMesh(data["vertices"].astype(np.float64), skeleton, indices, weights, parts, meta)
    except (FormatError, PoseError) as error:
        message = str(error)
        raise FormatError(message if message.startswith(str(path)) else f"{path}: {message}") from None
    except (TypeError, ValueError) as error:
        raise FormatError(f"{path}: {error}") from None


def _part(data: Mapping[str, NDArray[Any]], i: int, name: str, path: str) -> MeshPart:
    faces, faces_uv, uv = data[f"faces_{i}"], data[f"faces_uv_{i}"], data[f"uv_{i}"]
    if faces.ndim != 2 or faces.shape[1] != 3 or faces_uv.shape != faces.shape or uv.ndim != 2 or uv.shape[1] != 2:
        raise FormatError(f"faces_{i} and faces_uv_{i} need one shape (F, 3) and uv_{i} needs (T, 2)")
    if faces_uv.size and not 0 <= faces_uv.min() <= faces_uv.max() < len(uv):
        raise FormatError(f"faces_uv_{i} names texture coordinate {faces_uv.max()} of {len(uv)}")
    texture = decode_texture(data[f"texture_{i}"], f"{path}: texture_{i}")
    return MeshPart(name, faces.astype(np.int32), uv[faces_uv].astype(np.float64), texture)
