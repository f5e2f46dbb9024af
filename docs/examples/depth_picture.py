"""Colour and distance of an avatar and a floor in one frame: python depth_picture.py [OUT.png]"""

import sys

import cv2
import numpy as np

import glsplat
from glsplat.formats import load_motion

out = sys.argv[1] if len(sys.argv) > 1 else "depth.png"
avatar = glsplat.default_avatar()
x, z = (a.ravel() for a in np.meshgrid(np.linspace(-1.5, 1.5, 91), np.linspace(-2.0, 1.0, 91)))
floor = glsplat.Splats.create(
    means=np.stack([x, 0 * x - 0.01, z], axis=1),
    quats=np.tile([1.0, 0, 0, 0], (len(x), 1)),
    scales=np.tile([0.025, 0.002, 0.025], (len(x), 1)),
    opacities=np.full(len(x), 0.95),
    rgb=np.tile([0.45, 0.42, 0.38], (len(x), 1)),
)
person = glsplat.Item(avatar, pose=load_motion("wave-and-turn", avatar.skeleton).at(1.0))

size = (320, 400)
camera = glsplat.Camera(glsplat.look_at((0.7, 1.7, 2.4), (0, 0.8, 0)), glsplat.pinhole(*size, fov=50), *size)
config = glsplat.RenderConfig(target="32f")  # a target of 16 bits has depth to a centimetre
with glsplat.Renderer(glsplat.Scene([glsplat.Item(floor), person]), size=size, config=config) as renderer:
    images, depths = renderer.render([camera], depth=True)  # [1, H, W, 4], and [1, H, W] in metres, 0: nothing

seen = depths[0] > 0
near, far = np.percentile(depths[0][seen], [1, 99])
grey = np.uint8(255 * (1 - np.clip((depths[0] - near) / (far - near), 0, 0.95)))
coloured = np.where(seen[..., None], cv2.applyColorMap(grey, cv2.COLORMAP_TURBO), 0).astype(np.uint8)
if not cv2.imwrite(out, cv2.hconcat([cv2.cvtColor(images[0, ..., :3], cv2.COLOR_RGB2BGR), coloured])):
    sys.exit(f"{out} could not be written")
print(f"{out}: from {near:.2f} m (red) to {far:.2f} m (blue), {seen.mean():.0%} of the picture")
