"""Three viewers of one person, each with eyes, a pose and a size of its own."""

from __future__ import annotations

import numpy as np

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.skinning.pose import Pose

__all__ = ["parameters"]


def parameters(size):
    """Three viewers: their eyes and poses, and the size each asks for."""
    for index in range(3):
        pose = np.zeros((55, 3))
        pose[16, 2], pose[0, 1] = -0.9 * index, 0.8 * index
        pixels = (size + 16 * index, size)
        head = head_matrix((0.1 * index, 1.0 + 0.1 * index, 2.0 + 0.2 * index), (0, 0, 0, 1))
        yield stereo_cameras(head, size=pixels)[: 1 + (index != 1)], Pose(pose, np.zeros(3))
