"""A solver of one's own between tracking and avatar: python custom_solver.py [OUT.png]"""

import sys

import cv2

import glsplat
from glsplat.rotations import quaternion_product
from glsplat.skinning import JOINT_NAMES
from glsplat.tracking import AnalyticSolver, Body, Solution, Targets, Tracker, embedded_recording

out = sys.argv[1] if len(sys.argv) > 1 else "solved.png"
avatar, NECK = glsplat.default_avatar(), JOINT_NAMES.index("neck")
BOW = (0.966, 0.259, 0.0, 0.0)  # wxyz, 30 degrees forward


class Bowing(AnalyticSolver):
    """The analytic solver, with the head bowed; a learned model has the same ``reset()`` and ``solve()``."""

    def solve(self, targets: Targets, dt: float) -> Solution:
        """22 local rotations (wxyz) and the pelvis' place, ``dt`` seconds after the last."""
        solution = super().solve(targets, dt)
        solution.rotations[NECK] = quaternion_product(solution.rotations[NECK], BOW)
        return solution


# whatever a solver returns is checked and kept inside the limits of joints and speeds (docs/tracking.md)
tracker = Tracker(avatar.skeleton, solver=Bowing(Body.of(avatar.skeleton)))
for sample in embedded_recording()[:144]:  # two seconds of head and hands
    pose = tracker.update(sample)

size = (320, 400)
view = glsplat.look_at((0.8, 1.4, 2.2), (0, 0.95, 0))
camera = glsplat.Camera(view, glsplat.pinhole(*size, fov=54), *size, background=(0.85, 0.85, 0.8))
with glsplat.Renderer(avatar, size=size) as renderer:
    image = renderer.render([camera], pose)[0]
if not cv2.imwrite(out, cv2.cvtColor(image[..., :3], cv2.COLOR_RGB2BGR)):
    sys.exit(f"{out} could not be written")
print(f"{out}: neck {pose.rotations[NECK].round(2).tolist()}, flags {list(tracker.flags)}")
