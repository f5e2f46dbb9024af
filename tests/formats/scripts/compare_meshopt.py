"""EXT_meshopt_compression against meshoptimizer's own decoder: one person packed, and unpacked by glTF-Transform.

Run while developing, with a rigged .glb that has the extension:

    npx @gltf-transform/cli meshopt PERSON.glb packed.glb
    npx @gltf-transform/cli copy packed.glb plain.glb
    python -m tests.formats.scripts.compare_meshopt packed.glb plain.glb

Says how far vertices, faces and texture coordinates are apart. Five files (a walking person, a mage, a robot, a fox, a
mannequin; 1,728 to 7,214 vertices; filters NONE) agreed to the last bit.
"""

from __future__ import annotations

import sys

import numpy as np

from glsplat.formats.gltf.meshes.reader import read_gltf_person


def main(packed: str, plain: str) -> int:
    """0 when both are the same."""
    ours, theirs = read_gltf_person(packed), read_gltf_person(plain)
    if len(ours.vertices) != len(theirs.vertices) or len(ours.faces) != len(theirs.faces):
        print(
            f"{len(ours.vertices)} and {len(theirs.vertices)} vertices, {len(ours.faces)} and {len(theirs.faces)} faces"
        )
        return 1
    uv = [float(np.abs(a.uv - b.uv).max()) for a, b in zip(ours.parts, theirs.parts, strict=True) if len(a.faces)]
    apart = float(np.abs(ours.vertices - theirs.vertices).max())
    print(f"vertices {apart:.3g} m, uv {max(uv):.3g}, faces alike: {np.array_equal(ours.faces, theirs.faces)}")
    return int(apart > 0 or max(uv) > 0 or not np.array_equal(ours.faces, theirs.faces))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:3]))
