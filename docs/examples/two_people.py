"""Two people in a room, in one frame, with depth: python two_people.py [OUT.png]"""

import sys

import cv2
import numpy as np

import glsplat
from glsplat.data import person
from glsplat.formats import load_motion

out = sys.argv[1] if len(sys.argv) > 1 else "people.png"

# a room: a floor and a wall of flat splats (a capture: glsplat.load("room.ply"))
x, d = (a.ravel() for a in np.meshgrid(np.linspace(-2, 2, 81), np.linspace(0, 2.5, 51)))
tiles = np.where((np.floor(x * 2) + np.floor(d * 2)) % 2, 0.45, 0.35)[:, None]
room = glsplat.Splats.create(
    means=np.concatenate([np.stack([x, 0 * x, 1 - d], 1), np.stack([x, d, 0 * x - 1.5], 1)]),
    quats=[[1, 0, 0, 0]] * (2 * len(x)),
    scales=np.repeat([[0.03, 0.002, 0.03], [0.03, 0.03, 0.002]], len(x), axis=0),
    opacities=np.full(2 * len(x), 0.95),
    rgb=np.concatenate([tiles * [1, 1, 1], tiles * 0 + [0.55, 0.5, 0.45]]),
)

# turned about y by 53 degrees to either side, towards each other and the viewer, xyzw
ann = glsplat.Item(person("anna"), transform=glsplat.similarity((-0.55, 0, 0), (0, 0.5, 0, 1)))
bob = glsplat.Item(person("ben"), transform=glsplat.similarity((0.55, 0, 0), (0, -0.5, 0, 1)))
scene = glsplat.Scene([glsplat.Item(room), ann, bob])
wave, idle = load_motion("wave-and-turn", bob.content.skeleton), load_motion("idle", ann.content.skeleton)
size = (640, 480)
camera = glsplat.Camera(glsplat.look_at((0.3, 1.4, 3.2), (0, 0.9, 0)), glsplat.pinhole(*size, fov=45), *size)
with glsplat.Renderer(scene, size=size) as renderer:
    for seconds in (0.0, 0.5, 1.0):  # only Ann and Bob are posed again
        ann.pose, bob.pose = idle.at(seconds), wave.at(seconds)
        images, depths = renderer.render([camera], depth=True)

if not cv2.imwrite(out, cv2.cvtColor(images[0, ..., :3], cv2.COLOR_RGB2BGR)):
    sys.exit(f"{out} could not be written")
print(f"{out}: {len(scene)} items, up to {depths.max():.2f} m away, {renderer.stats.drawn} splats drawn")
