"""What drawing poses ahead of their samples does: error when they are seen, and trembling, of head and hands.

    python -m tools.net.ahead_table MOTION ...      # BVH, AMC or JSON files; seconds a motion

A headset sees the motion at 72 Hz with 0.7 mm and 0.1 degrees of noise; pictures are seen so many milliseconds later.
Without a prediction the pose is that of the sample; with it, the server's (glsplat/net/backends/tracking.py). Errors
are against the true joints at the moment of seeing. Trembling: the mean third derivative, as a ratio to that without.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from glsplat.data import default_avatar
from glsplat.extras.motions.derive import Disturbance, derive, disturb, truth_from_motion
from glsplat.formats.motion_files import load_motion
from glsplat.net.backends.tracking import HORIZON_SHARE, MAX_HORIZON_S
from glsplat.tracking.tracker import Tracker

RATE, SECONDS = 72, 12
AGES = (0.03, 0.06, 0.1, 0.15)  # seconds
HEAD, HANDS = 15, (20, 21)
NOISE = Disturbance(noise_mm=0.7, noise_deg=0.1)

Joints = NDArray[np.float64]


def third(joints: Joints) -> float:
    """Mean third derivative, m/s^3."""
    return float(np.linalg.norm(np.diff(joints, 3, axis=0), axis=-1).mean() * RATE**3)


def main(files: Sequence[str]) -> None:
    skeleton = default_avatar().skeleton
    print("| age, ms | ahead, ms | head, cm | with | trembling | hands, cm | with | trembling |")
    print("|--:|--:|--:|--:|--:|--:|--:|--:|")
    runs = []
    for file in files:
        motion = load_motion(file, skeleton)
        count = min(round(SECONDS * motion.fps), len(motion.trans))
        truth = truth_from_motion(skeleton, motion.rotations[:count], motion.trans[:count], motion.fps, RATE)
        runs.append((truth.positions, disturb(derive(skeleton, truth, fingers=False), NOISE)))
    still = [_drawn(skeleton, samples, 0.0) for _, samples in runs]
    for age in AGES:
        ahead, late = min(HORIZON_SHARE * age, MAX_HORIZON_S), round(age * RATE)
        cells = [f"{age * 1e3:.0f}", f"{ahead * 1e3:.0f}"]
        moved = [_drawn(skeleton, samples, ahead) for _, samples in runs]
        for joints in ([HEAD], list(HANDS)):
            errors, trembling = [], []
            for (true, _), old, new in zip(runs, still, moved, strict=True):
                parts = [one[RATE:-late][:, joints] - true[RATE + late :][:, joints] for one in (old, new)]
                errors.append([np.linalg.norm(part, axis=-1).mean() * 100 for part in parts])
                trembling.append([third(one[RATE:][:, joints]) for one in (old, new)])
            before, after = np.mean(errors, axis=0)
            rest, shaken = np.mean(trembling, axis=0)
            cells += [f"{before:.2f}", f"{after:.2f}", f"{shaken / rest:.2f}"]
        print("| " + " | ".join(cells) + " |", flush=True)


def _drawn(skeleton, samples, ahead: float) -> Joints:  # type: ignore[no-untyped-def]
    tracker = Tracker(skeleton, solver="learned")
    tracker.prediction = ahead
    return np.array([tracker.joints(tracker.update(sample))[:22] for sample in samples])


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("motions", nargs="+")
    main(parser.parse_args().motions)
