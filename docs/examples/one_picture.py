"""Render one picture of an avatar in a pose: python one_picture.py [OUT.png] [AVATAR.glb]"""

import sys

import cv2
import numpy as np

import glsplat

out = sys.argv[1] if len(sys.argv) > 1 else "picture.png"
avatar = glsplat.load(sys.argv[2]) if len(sys.argv) > 2 else glsplat.default_avatar()

body = np.zeros((21, 3))  # SMPL-X's body joints without the pelvis, axis-angle in radians
body[15] = 0, 0, -1.1  # left shoulder: the arm hangs down
body[16] = 0, 0, 1.1  # right shoulder
pose = glsplat.Pose.from_smplx({"body_pose": body})

size = (480, 640)
view = glsplat.look_at(eye=(0.6, 1.3, 2.6), target=(0, 0.85, 0))
camera = glsplat.Camera(view, glsplat.pinhole(*size, fov=45), *size)
with glsplat.Renderer(avatar, size=size) as renderer:
    image = renderer.render([camera], pose)[0]  # [H, W, 4], colours times alpha

# PNG files want straight alpha, OpenCV wants blue first
if not cv2.imwrite(out, cv2.cvtColor(glsplat.straight(image), cv2.COLOR_RGBA2BGRA)):
    sys.exit(f"{out} could not be written")
print(f"{out}: {size[0]}x{size[1]}, the avatar covers {(image[..., 3] > 127).mean():.0%}")
