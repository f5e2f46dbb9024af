"""The tracker's promises on input that nobody should send."""

from __future__ import annotations

import numpy as np

from glsplat.avatar import default_avatar
from glsplat.skinning.skeleton import rotation_matrices
from glsplat.tracking.sample import Sample
from glsplat.tracking.tracker import Tracker, TrackerConfig


def sample(t: float, head: list[float] | None, left: list[float] | None = None) -> Sample:
    return Sample.from_json({"t": t, "head": head, "left": left, "right": None})


def test_a_gap_that_ends_with_the_head_lost() -> None:
    tracker = Tracker(default_avatar().skeleton)
    tracker.update(sample(0.0, [0, 1.7, 0, 0, 0, 0, 1]))
    pose = tracker.update(sample(10.0, None, [0.3, 1.0, -0.3, 0, 0, 0, 1]))
    assert np.isfinite(pose.rotations).all() and {"head_lost", "gap"} <= set(tracker.flags)


def test_no_joint_turns_faster_than_configured() -> None:
    """Random heads at 72 Hz, within one teleport of each other: the limit holds through the joint limits too."""
    rng = np.random.default_rng(5)
    config = TrackerConfig()
    tracker = Tracker(default_avatar().skeleton, config=config)
    last, fastest = None, 0.0
    for i in range(300):
        turn = rng.normal(size=4)
        head = [*(rng.uniform(-0.2, 0.2, 3) + (0, 1.5, 0)), *(turn / np.linalg.norm(turn))]
        pose = tracker.update(sample(i / 72, head))
        now = rotation_matrices(pose.rotations[:22])
        if last is not None and not {"teleport", "gap"} & set(tracker.flags):
            chord = np.linalg.norm(now - last, axis=(1, 2)) / np.sqrt(8)
            fastest = max(fastest, float((2 * np.arcsin(np.clip(chord, 0, 1)))[1:].max()) * 72)
        last = now
    assert 10 < fastest < 1.02 * config.joint_speed
