"""Bindings of all programs: texture units by sampler name, and the slot of the uniform block."""

from __future__ import annotations

FRAME_BLOCK = 0
"""Slot of the uniform block Frame (frame.glsl)."""

UNITS = {
    "splats": 0,  # arena: geometry (splat_input.glsl)
    "colours": 1,  # arena: SH (sh.glsl)
    "surfaces": 2,  # arena: normals and shades (light.glsl)
    "bones": 2,  # bone texture of an avatar or a mesh (skin.glsl)
    "mesh_z": 3,  # meshes of a scene, a texture a view (mesh_layer.glsl)
    "mesh_z_2": 6,
    "mesh_colour": 4,
    "mesh_colour_2": 7,
    "mesh_samples": 8,
    "mesh_samples_2": 9,
    "entries": 0,  # shapes of an avatar (shapes.glsl)
    "amounts": 1,
    "skin_texture": 5,  # of a mesh
    "records": 0,  # records that es300 fetches by index (record_input.glsl)
    "target": 0,  # float layers (resolve.frag.glsl, present.frag.glsl, eyes.frag.glsl)
    "step_texture": 1,  # of a step (resolve.frag.glsl)
    "depth_sum": 1,  # beside the float layers (eyes.frag.glsl)
    "text": 1,  # over a window (present.frag.glsl)
}
"""Sampler -> texture unit. Two samplers share a unit only if no program has both."""
