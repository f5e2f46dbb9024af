"""Both eyes of a headset in one pass: python stereo_pair.py [OUT.png]"""

import sys
from dataclasses import replace

import cv2
import numpy as np

import glsplat
from glsplat.camera import head_matrix

out = sys.argv[1] if len(sys.argv) > 1 else "pair.png"

# as OpenXR and WebXR give it: metres, y up, -z forward; quaternion x, y, z, w
position, orientation = (0.3, 1.5, 1.8), (-0.13, 0.08, 0.01, 0.99)
head = head_matrix(position, np.array(orientation) / np.linalg.norm(orientation))

size = (400, 400)  # pixels an eye
left, right = glsplat.stereo_cameras(head, ipd=0.063, fov=65, size=size)
left, right = (replace(eye, background=(0.85, 0.85, 0.8)) for eye in (left, right))
with glsplat.Renderer(glsplat.default_avatar(), size=size, views=2) as renderer:
    images = renderer.render([left, right])  # [2, H, W, 4]

if not cv2.imwrite(out, cv2.cvtColor(np.hstack([*images[..., :3]]), cv2.COLOR_RGB2BGR)):
    sys.exit(f"{out} could not be written")
apart = np.linalg.norm(left.position - right.position)
print(
    f"{out}: eyes {apart * 1000:.0f} mm apart, {np.abs(images[0].astype(int) - images[1]).max()} levels of difference"
)
