"""Base colours of glTF materials: factor, texture, texture transform and alpha cut-off."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.formats.texture import decode_texture
from glsplat.formats.gltf.container import Container
from glsplat.formats.gltf.schema import Accessor
from glsplat.pictures import to_linear, to_srgb

_PLAIN = 4  # texels a side of a texture of one colour
_WEBP, _TRANSFORM, _BASIS = "EXT_texture_webp", "KHR_texture_transform", "KHR_texture_basisu"


@dataclass(frozen=True, eq=False)
class Material:
    """The unlit colours of a surface."""

    texture: NDArray[np.uint8]  # [H, W, 4]; alpha below 128 is cut out
    coordinates: int  # TEXCOORD_n
    turn: NDArray[np.float64]  # [2, 3] of glTF's texture coordinates (KHR_texture_transform)
    name: str
    alpha: NDArray[np.uint8] | None = None  # [H, W] times the factor, before the cut; None: opaque
    cut: float = 127.5  # of 255; alpha below it is cut out

    def coloured(self) -> NDArray[np.uint8]:
        """Return the texture [H, W, 4] with the alpha that vertices' colours multiply; ``cut_out`` follows."""
        return self.texture if self.alpha is None else np.dstack([self.texture[..., :3], self.alpha])

    def cut_out(self, texture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a texture made from ``coloured``, with its cut-off at one half."""
        return texture if self.alpha is None else np.dstack([texture[..., :3], _halved(texture[..., 3], self.cut)])


def material_of(container: Container, index: int | None) -> Material:
    """Return the base colour of a material; white without one. Raises FormatError naming the material."""
    gltf = container.gltf
    try:
        entry: Any = gltf.materials[index] if index is not None else {}
        base = entry.get("pbrMetallicRoughness", {})
        factor = np.array(base.get("baseColorFactor", (1, 1, 1, 1)), np.float64)
        if factor.shape != (4,) or not np.isfinite(factor).all():
            raise ValueError
        image, coordinates, turn = np.full((_PLAIN, _PLAIN, 4), 255, np.uint8), 0, np.eye(2, 3)
        if "baseColorTexture" in base:
            used = base["baseColorTexture"]
            turn, coordinates = _transform(used.get("extensions", {}).get(_TRANSFORM, {}), int(used.get("texCoord", 0)))
            image = _image(container, gltf.textures[used["index"]])
        name, mode = str(entry.get("name") or ""), entry.get("alphaMode", "OPAQUE")
        if mode == "OPAQUE":
            texture = np.concatenate([_tinted(image, factor), np.full((*image.shape[:2], 1), 255, np.uint8)], axis=-1)
            return Material(texture, coordinates, turn, name)
        alpha = np.rint(np.clip(np.arange(256) * float(factor[3]), 0, 255)).astype(np.uint8)[image[..., 3]]
        cut = float(entry.get("alphaCutoff", 0.5)) * 255 if mode == "MASK" else 127.5
        return Material(np.dstack([_tinted(image, factor), _halved(alpha, cut)]), coordinates, turn, name, alpha, cut)
    except (AttributeError, KeyError, IndexError, OverflowError, TypeError, ValueError):
        raise FormatError(f"material {index} is malformed") from None


def _halved(alpha: NDArray[np.uint8], cut: float) -> NDArray[np.uint8]:
    """Shift alpha so that its cut-off moves from ``cut`` of 255 to one half."""
    return np.rint(np.clip(127.5 + (np.arange(256) - cut), 0, 255)).astype(np.uint8)[alpha]


def _tinted(image: NDArray[np.uint8], factor: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return the image [H, W, 3] times the linear factor."""
    out = image[..., :3]
    if (factor[:3] != 1).any():
        table = to_linear(np.arange(256) / 255.0)
        out = out.copy()
        for channel in range(3):
            values = to_srgb(np.clip(table * factor[channel], 0, 1))
            out[..., channel] = np.rint(values * 255).astype(np.uint8)[image[..., channel]]
    return out


def _transform(entry: Mapping[str, Any], coordinates: int) -> tuple[NDArray[np.float64], int]:
    """Parse KHR_texture_transform to a matrix [2, 3] and its set of coordinates; rotation is counter-clockwise."""
    angle = float(entry.get("rotation", 0.0))
    offset, scale = (
        np.array(entry.get(name, default), np.float64) for name, default in (("offset", (0, 0)), ("scale", (1, 1)))
    )
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, sin], [-sin, cos]]) * scale  # columns are scaled: scale first
    if offset.shape != (2,) or not np.isfinite(turn).all() or not np.isfinite(offset).all():
        raise ValueError
    return np.column_stack([turn, offset]), int(entry.get("texCoord", coordinates))


def _image(container: Container, texture: Mapping[str, Any]) -> NDArray[np.uint8]:
    more = texture.get("extensions", {})
    source = more[_WEBP]["source"] if _WEBP in more else texture.get("source")
    if source is None:
        kind = f" ({_BASIS})" if _BASIS in more else ""
        raise FormatError(
            f"a texture is in a format of graphics cards{kind}; "
            "unpack it: npx @gltf-transform/cli ktxdecompress IN.glb OUT.glb"
        )
    return decode_texture(_bytes_of(container, container.gltf.images[source]), f"image {source}")


def _bytes_of(container: Container, image: Mapping[str, Any]) -> bytes:
    if "bufferView" in image:
        view = container.gltf.buffer_views[image["bufferView"]]
        # an accessor of bytes, so that the bounds are checked in one place
        container.gltf.accessors.append(
            Accessor(component_type=5121, count=view.byte_length, type="SCALAR", buffer_view=image["bufferView"])
        )
        return container.read(len(container.gltf.accessors) - 1, "image", ("SCALAR",)).tobytes()
    return container.fetched(str(image["uri"]), "image")
