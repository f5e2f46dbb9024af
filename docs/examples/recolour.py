"""Change an avatar's splats, save it and load it again: python recolour.py [OUT.png] [OUT.glb]"""

import sys
from dataclasses import replace

import cv2
import numpy as np

import glsplat

out = sys.argv[1] if len(sys.argv) > 1 else "recoloured.png"
file = sys.argv[2] if len(sys.argv) > 2 else "recoloured.glb"
avatar = glsplat.default_avatar()
splats = avatar.splats

# values never change: new arrays make new values. What is blue above the hips swaps red and blue
height = avatar.skeleton.joints[avatar.skeleton.names.index("pelvis"), 1]
red, blue = splats.sh[:, 0, 0], splats.sh[:, 0, 2]  # degree 0: (rgb - 0.5) / 0.2821
jersey = (splats.means[:, 1] > height - 0.05) & (blue - red > 0.8)
sh = np.where(jersey[:, None, None], splats.sh[..., ::-1], splats.sh)
changed = replace(avatar, splats=replace(splats, sh=sh))
glsplat.save(changed, file)

size = (400, 420)
camera = glsplat.Camera(glsplat.look_at((0.6, 1.2, 2.4), (0, 0.9, 0)), glsplat.pinhole(*size, fov=50), *size)
camera = replace(camera, background=(1, 1, 1))
both = []
for person in (avatar, glsplat.load(file)):
    with glsplat.Renderer(person, size=size) as renderer:
        both.append(renderer.render([camera])[0, ..., :3])
if not cv2.imwrite(out, cv2.cvtColor(np.hstack(both), cv2.COLOR_RGB2BGR)):
    sys.exit(f"{out} could not be written")
print(f"{out}: {jersey.sum()} splats changed; {file}: {glsplat.load(file)}")
