"""The levels of detail of an avatar, each at the size it is made for: python levels_of_detail.py [OUT.png]"""

import sys

import cv2
import numpy as np

import glsplat
from glsplat.splats import Level

out = sys.argv[1] if len(sys.argv) > 1 else "levels.png"
avatar = glsplat.default_avatar()
levels = (Level(avatar, density=float("inf")), *avatar.levels)
size, strip, said = (520, 500), [], []
for level in levels:
    density = min(level.density, 240)  # pixels a metre up to which a level is enough: focal length over distance
    distance = 600 / density
    eye = glsplat.look_at((0, 0.93, distance), (0, 0.93, 0))
    pinhole = [[600, 0, size[0] / 2], [0, 600, size[1] / 2], [0, 0, 1]]
    camera = glsplat.Camera(eye, np.array(pinhole), *size, background=(1, 1, 1))
    with glsplat.Renderer(level.content, size=size) as renderer:
        strip.append(renderer.render([camera])[0, ..., :3])
    said.append(f"{len(level.content.splats)} splats from {distance:.1f} m")

if not cv2.imwrite(out, cv2.cvtColor(np.hstack(strip), cv2.COLOR_RGB2BGR)):
    sys.exit(f"{out} could not be written")
print(f"{out}: {'; '.join(said)}")
