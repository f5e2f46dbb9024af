"""How well an avatar shows the mesh it was made from: python score_avatar.py AVATAR.glb MESH.npz|MESH.glb [POSES]"""

import sys

import numpy as np

import glsplat
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.evaluate import SCORE_POSES, score

poses = sys.argv[3] if len(sys.argv) == 4 else "3"
if len(sys.argv) not in (3, 4) or poses not in map(str, range(1, len(SCORE_POSES) + 1)):
    sys.exit(f"{__doc__}\nPOSES is 1 to {len(SCORE_POSES)}, 3 if left out")
names, size = list(SCORE_POSES)[: int(poses)], (256, 256)
config = glsplat.RenderConfig(output="float32")
try:
    avatar, mesh = glsplat.load(sys.argv[1]), glsplat.load(sys.argv[2])
    if not isinstance(avatar, glsplat.Avatar) or not isinstance(mesh, glsplat.RiggedMesh):
        sys.exit("needs an avatar and the rigged mesh it was made from")
    with (
        MeshTruth(mesh, size=size, output="float32") as truth,
        glsplat.Renderer(avatar, size=size, config=config, context=truth.context) as renderer,
    ):
        scores = list(score(renderer, truth, avatar, mesh, names, views=2))
except glsplat.GlsplatError as error:
    sys.exit(str(error))

for s in scores:
    print(f"{s.pose:18} from {s.azimuth:3.0f} degrees: body {s.body:5.1f} dB, SSIM {s.ssim:.4f}")
print(f"worst {min(s.body for s in scores):.1f} dB, mean {np.mean([s.body for s in scores]):.1f} dB")
