"""What viewers show of splats that know nothing of them: a cloud of points in the splats' plain colours.

KHR_gaussian_splatting, "Fallback Behavior": COLOR_0 holds the colour of degree 0 and the opacity; a renderer of splats
ignores it and the material. Without light a viewer would show a lit material black, hence an unlit one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from glsplat.formats.gltf.output import Output
from glsplat.splats import SH_C0, Splats

__all__ = ["UNLIT", "unlit_material", "write_fallback"]

UNLIT = "KHR_materials_unlit"


def write_fallback(out: Output, splats: Splats, kind: type[np.uint8 | np.uint16]) -> int:
    """Index of the accessor for COLOR_0: linear RGB and opacity as 8 or 16 bits each.

    glTF wants vertex colours linear; with 8 bits the darkest sRGB colours are up to 6 levels off, with 16 bits 0.05.
    Values outside 0 to 1 are clamped, NaN becomes 0.
    """
    colours = np.empty((len(splats), 4), np.float32)
    colours[:, :3] = splats.sh[:, 0] * np.float32(SH_C0) + np.float32(0.5)
    colours[:, 3] = splats.opacities
    np.clip(np.nan_to_num(colours, copy=False), 0, 1, out=colours)
    srgb = colours[:, :3]
    srgb[...] = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return out.add(np.rint(colours * np.iinfo(kind).max).astype(kind), "VEC4", normalized=True)


def unlit_material(name: str) -> dict[str, Any]:
    """A material that shows colours as they are, where a viewer knows KHR_materials_unlit, else rough and no metal."""
    return {
        "name": name,
        "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1},
        "extensions": {UNLIT: {}},
    }
