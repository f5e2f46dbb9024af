"""A solver of one's own between tracking and avatar: python custom_solver.py [OUT.png]

This one wraps the analytic solver and bows the head; a learned model fills the same two methods.
"""

import sys

import cv2

import glsplat
from glsplat.rotations import quaternion_product
from glsplat.skinning import JOINT_NAMES
from glsplat.tracking import AnalyticSolver, Body, Solution, Targets, Tracker, embedded_recording

out = sys.argv[1] if len(sys.argv) > 1 else "solved.png"
avatar = glsplat.default_avatar()
NECK = JOINT_NAMES.index("neck")
BOW = (0.966, 0.259, 0.0, 0.0)  # wxyz, 30 degrees forward


class Bowing:
    """The analytic solver, with the head bowed."""

    def __init__(self) -> None:
        self.inner = AnalyticSolver(Body.of(avatar.skeleton))

    def reset(self) -> None:
        """A teleport or a new user."""
        self.inner.reset()

    def solve(self, targets: Targets, dt: float) -> Solution:
        """22 local rotations (wxyz) and the pelvis' place, ``dt`` seconds after the last."""
        solution = self.inner.solve(targets, dt)
        solution.rotations[NECK] = quaternion_product(solution.rotations[NECK], BOW)
        return solution


# whatever a solver returns is checked and kept inside the limits of joints and speeds (docs/tracking.md)
tracker = Tracker(avatar.skeleton, solver=Bowing())
for sample in embedded_recording()[:144]:  # two seconds of head and hands
    pose = tracker.update(sample)

size = (320, 400)
camera = glsplat.Camera(glsplat.look_at((0.8, 1.4, 2.2), (0, 0.9, 0)), glsplat.pinhole(*size, fov=50), *size)
with glsplat.Renderer(avatar, size=size) as renderer:
    image = renderer.render([camera], pose)[0]
if not cv2.imwrite(out, cv2.cvtColor(image[..., :3], cv2.COLOR_RGB2BGR)):
    sys.exit(f"{out} could not be written")
print(f"{out}: neck {pose.rotations[NECK].round(2).tolist()}, flags {list(tracker.flags)}")
