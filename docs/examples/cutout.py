"""An avatar with clean edges in front of a picture: python cutout.py [OUT.png] [BACKGROUND.jpg]"""

import sys

import cv2
import numpy as np

import glsplat
from glsplat.formats import load_motion

out = sys.argv[1] if len(sys.argv) > 1 else "cutout.png"
size = (480, 480)
if len(sys.argv) > 2:
    found = cv2.imread(sys.argv[2])
    if found is None:
        sys.exit(f"{sys.argv[2]} could not be read")
    behind = cv2.cvtColor(cv2.resize(found, size), cv2.COLOR_BGR2RGB)
else:  # a sky over a meadow
    height = np.linspace(0, 1, size[1])[:, None, None]
    sky, meadow = np.array([150, 190, 235.0]), np.array([95, 140, 75.0])
    behind = np.tile(np.where(height < 0.7, sky + 70 * height, meadow * (1.6 - height)), (1, size[0], 1))

avatar = glsplat.default_avatar()
pose = load_motion("walk", avatar.skeleton).pose(0)
camera = glsplat.Camera(glsplat.look_at((1.2, 1.1, 2.2), (0, 0.85, 0)), glsplat.pinhole(*size, fov=48), *size)
with glsplat.Renderer(avatar, size=size) as renderer:
    image = renderer.render([camera], pose)[0].astype(float)  # on black: colours times alpha

over = image[..., :3] + behind * (1 - image[..., 3:] / 255)  # premultiplied "over": nothing is multiplied twice
if not cv2.imwrite(out, cv2.cvtColor(over.clip(0, 255).astype(np.uint8), cv2.COLOR_RGB2BGR)):
    sys.exit(f"{out} could not be written")
print(f"{out}: {((image[..., 3] > 0) & (image[..., 3] < 255)).mean():.1%} of the pixels are edges")
