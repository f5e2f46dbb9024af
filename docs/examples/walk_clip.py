"""Play a motion and write a clip that browsers play: python walk_clip.py [OUT.mp4] [MOTION]"""

import sys

import cv2

import glsplat
from glsplat.formats import load_motion

out = sys.argv[1] if len(sys.argv) > 1 else "walk.mp4"
avatar = glsplat.default_avatar()
motion = load_motion(sys.argv[2] if len(sys.argv) > 2 else "walk", avatar.skeleton)  # or a BVH, AMASS, glTF, JSON file

size, rate = (240, 320), 24
frames = []
with glsplat.Renderer(avatar, size=size) as renderer:
    for step in range(round(min(2 * motion.duration, 10) * rate)):
        pose = motion.at(step / rate)  # between two frames of the motion the joints turn by slerp
        x, _, z = pose.trans  # the camera goes along
        view = glsplat.look_at((x + 1.8, 1.2, z + 2.4), (x, 0.9, z))
        camera = glsplat.Camera(view, glsplat.pinhole(*size, fov=40), *size, background=(0.8, 0.85, 0.9))
        frames.append(renderer.render([camera], pose)[0, ..., :3])

writer = cv2.VideoWriter(out, cv2.VideoWriter_fourcc(*"vp09"), rate, size)
if not writer.isOpened():
    sys.exit(f"{out} could not be written")
for frame in frames:
    writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
writer.release()
cv2.imwrite(f"{out}.png", cv2.cvtColor(cv2.hconcat(frames[::6][:4]), cv2.COLOR_RGB2BGR))
print(f"{out}: {len(frames)} pictures, {rate} a second; four of them in {out}.png")
