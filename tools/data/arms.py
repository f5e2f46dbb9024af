"""Make the mixture of standing arm poses (glsplat/extras/authoring/fit/arm_mixture.json) from captured motion.

    python -m tools.data.arms FOLDER OUT.json

FOLDER holds the packs cmu_SUBJECT_CLIP.npz. At most four frames per second are used in which somebody stands upright on
both feet with nearly straight legs; right arms are mirrored. No clip is written.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from glsplat.arrays import F64
from glsplat.extras.authoring.fit.prior import ArmMixture
from tools.data.sizes import forward

CREDIT = (
    "The data used in this project was obtained from mocap.cs.cmu.edu. "
    "The database was created with funding from NSF EIA-0196217."
)
HELD_BACK = ("08", "14", "61", "94", "135")
"""Subjects held back from learning, for tests."""

KINDS = 8
RATE = 4.0  # frames per second
UPRIGHT, STRAIGHT, LEVEL, FLOOR = 0.94, 0.96, 0.06, 0.16  # cosine, share of the leg's length, metres, metres
MOST = 60  # frames of one clip, so that long clips do not dominate
OTHERS, WIDER = 0.3, 1.5  # share of people who stand otherwise, and their variance relative to the pack's
WIDEN = 0.12  # radians added to each component's deviation: people vary more than the pack


def arms_of(path: Path) -> F64:
    """Return the arm poses [N, 4] of a clip's standing people; see ``ArmMixture``."""
    with np.load(path) as data:
        pack = {key: data[key] for key in data.files}
    names = [str(name) for name in pack["joint_names"]]
    step = max(round(float(pack["fps"]) / RATE), 1)
    at = pack["pos_i16"][::step] * float(pack["pos_scale"]) + pack["pos_offset"]
    turns, _ = forward(pack["local_quat_i16"][::step], pack["parents"], pack["rest_offsets"])

    def joint(name: str) -> F64:
        return np.asarray(at[:, names.index(name)], np.float64)

    stands = turns[:, 0, 1, 1] > UPRIGHT
    for side in "lr":
        hip, knee, ankle = (joint(f"{side}_{name}") for name in ("hip", "knee", "ankle"))
        long = np.linalg.norm(hip - knee, axis=1) + np.linalg.norm(knee - ankle, axis=1)
        stands &= np.linalg.norm(hip - ankle, axis=1) > STRAIGHT * long
    heights = np.stack([joint("l_ankle")[:, 1], joint("r_ankle")[:, 1]])
    stands &= (np.ptp(heights, axis=0) < LEVEL) & (heights.min(axis=0) < FLOOR)
    chosen = np.flatnonzero(stands)
    chosen = chosen[np.unique(np.linspace(0, max(len(chosen) - 1, 0), min(MOST, len(chosen))).astype(int))]
    arms = []
    for side, out in (("l", 1.0), ("r", -1.0)):
        collar = turns[chosen, names.index(f"{side}_collar")]
        bones = [
            joint(f"{side}_{end}")[chosen] - joint(f"{side}_{start}")[chosen]
            for start, end in (("shoulder", "elbow"), ("elbow", "wrist"))
        ]
        upper, fore = (np.einsum("nji,nj->ni", collar, bone) * (out, 1, 1) for bone in bones)
        arms.append(ArmMixture.angles_of(upper, fore))
    return np.concatenate(arms)


def learned(arms: F64, kinds: int = KINDS, seed: int = 0, steps: int = 200) -> ArmMixture:
    """Return a mixture of ``kinds`` Gaussians fitted to arms [N, 4] by expectation maximisation from seeded starts."""
    rng = np.random.default_rng(seed)
    means = arms[rng.choice(len(arms), 1)]
    while len(means) < kinds:  # start far from each other
        away = ((arms[:, None] - means) ** 2).sum(-1).min(axis=1)
        means = np.concatenate([means, arms[rng.choice(len(arms), 1, p=away / away.sum())]])
    own = np.eye(arms.shape[1]) * WIDEN**2
    mixture = ArmMixture(np.full(kinds, 1 / kinds), means, np.tile(np.cov(arms.T) / kinds + own, (kinds, 1, 1)))
    for _ in range(steps):
        level = mixture.log_densities(arms)
        share = np.exp(level - np.logaddexp.reduce(level, axis=1)[:, None])
        count = share.sum(axis=0) + 1e-9
        means = share.T @ arms / count[:, None]
        off = arms[:, None] - means
        spreads = np.einsum("nk,nki,nkj->kij", share, off, off) / count[:, None, None] + own
        mixture = ArmMixture(count / count.sum(), means, spreads)
    return mixture


def with_others(mixture: ArmMixture) -> ArmMixture:
    """Return the mixture with one more Gaussian as wide as all: the pack has hardly any hands on hips."""
    mean = mixture.shares @ mixture.means
    off = mixture.means - mean
    spread = np.einsum("k,kij->ij", mixture.shares, mixture.covariances + off[:, :, None] * off[:, None])
    shares = np.append(mixture.shares * (1 - OTHERS), OTHERS)
    return ArmMixture(
        shares, np.vstack([mixture.means, mean]), np.concatenate([mixture.covariances, WIDER * spread[None]])
    )


def write_mixture(mixture: ArmMixture, path: Path, made_from: str) -> None:
    """Write the mixture as JSON, the most frequent Gaussian first."""
    kinds = [
        {
            "share": round(float(mixture.shares[k]), 4),
            "mean": [round(float(v), 3) for v in mixture.means[k]],
            "spread": [[round(float(v), 4) for v in row] for row in mixture.covariances[k]],
        }
        for k in np.argsort(-mixture.shares, kind="stable")
    ]
    what = (
        "how people who stand hold their arms: shoulder (axis-angle), elbow (about y), radians, as the left arm turns"
    )
    head = json.dumps({"what": what, "made_from": made_from, "credit": CREDIT}, indent=1)[:-2]
    rows = ",\n".join("  " + json.dumps(kind) for kind in kinds)
    path.write_text(f'{head},\n "kinds": [\n{rows}\n ]\n}}\n', encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    clips = sorted(path for path in options.folder.glob("cmu_*.npz") if path.name.split("_")[1] not in HELD_BACK)
    arms = np.concatenate([arms_of(path) for path in clips])
    subjects = len({path.name.split("_")[1] for path in clips})
    made_from = f"{len(arms)} arms of {subjects} subjects in {len(clips)} clips of CMU's motion capture"
    write_mixture(with_others(learned(arms)), options.out, made_from)
    print(made_from)


if __name__ == "__main__":
    main()
