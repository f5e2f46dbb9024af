"""Measure how well a session finds a user's size, with scaled captured people who stand, walk, sit or crouch first.

    python -m tools.data.sizes PACK             # a folder of clips as in the CMU pack (cmu_SUBJECT_CLIP.npz)

People keep their own proportions: eyes and wrists come from the captured skeletons. A session is 13 s of moments in
which somebody stands or walks upright, the calmest clips first ("mid-walk": walking only). Synthetic seats and crouches
of 4 s or 20 s precede it: eyes over a chair of 45 cm (sitting eye height is 45 % of the stature) with hands on the lap
or holding controllers ahead, or eyes at 72 % of their height.
"""

from __future__ import annotations

import argparse
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glsplat.data import default_avatar
from glsplat.rotations import matrix_quaternions, quaternion_matrices
from glsplat.tracking.body_size import BodySizeFinder
from glsplat.tracking.calibration import EYES_OF_STATURE
from glsplat.tracking.solve.body import Body

Array = NDArray[np.float64]

RATE = 30.0  # Hz of the pack
STARTS = {"standing": 0.0, "mid-walk": 0.0, "seated 4 s": 4.0, "seated 20 s": 20.0, "crouched 4 s": 4.0}
SCALES = (0.8, 0.9, 1.0, 1.1)
STOOD, ASKED, RISES = 13.0, 10.0, 0.8  # seconds: of a session, of standing before the measurement, of getting up
EYES_AHEAD = 0.09  # metres from the top of the head's bone to between the eyes
TALL, TALLEST, CHEST = 0.93, 1.08, 0.94  # of upright people: share of the pelvis' height (two), cosine of the chest
WALKS = 0.5  # m/s


@dataclass(frozen=True)
class Part:
    """A second or more of an upright person."""

    pace: float  # m/s
    eyes: Array  # [T, 3] metres
    head: Array  # [T, 4]
    hands: Array  # [T, 2, 3] from the eyes


@dataclass(frozen=True)
class Person:
    """Eye height in the zero pose, metres, and upright moments."""

    eye_height: float
    parts: tuple[Part, ...]

    def session(self, walking: bool) -> Part | None:
        """Return a session of up to STOOD seconds; None if there are too few moments."""
        chosen = sorted((p for p in self.parts if p.pace > WALKS or not walking), key=lambda part: part.pace)
        count, at = round(STOOD * RATE), np.zeros(3)
        if sum(len(part.eyes) for part in chosen) < (ASKED + 0.5) * RATE:
            return None
        eyes = []
        for part in chosen:  # join their paths
            eyes.append(part.eyes + (at - part.eyes[0]) * [1, 0, 1])
            at = eyes[-1][-1]
        head, hands = [np.concatenate([getattr(part, name) for part in chosen])[:count] for name in ("head", "hands")]
        return Part(0.0, np.concatenate(eyes)[:count], head, hands)


@dataclass(frozen=True)
class Found:
    """Errors of one session, as shares of the true size."""

    subject: str
    scale: float
    off: float  # after ASKED seconds upright
    worse: float  # largest error after 3 s, minus that of scale 1


def persons(clips: Iterable[Path]) -> dict[str, Person]:
    """Return proportions and upright moments by subject, from files cmu_SUBJECT_CLIP.npz."""
    heights: dict[str, list[float]] = defaultdict(list)
    parts: dict[str, list[Part]] = defaultdict(list)
    for path in sorted(clips):
        subject = path.stem.rsplit("_", 1)[0]
        with np.load(path) as clip:
            rate, at = float(clip["fps"]), clip["pos_i16"] * clip["pos_scale"].astype(float) + clip["pos_offset"]
            quats, parents, offsets = clip["local_quat_i16"], clip["parents"], clip["rest_offsets"]
            names = [str(n) for n in clip["joint_names"]]
        if abs(rate - RATE) > 1:
            continue
        index = {name: i for i, name in enumerate(names)}
        turns, rest = forward(quats, parents, offsets)
        ankles = [index["l_ankle"], index["r_ankle"]]
        sole = float(np.clip(np.percentile(at[:, ankles, 1].min(1), 20), 0.06, 0.15))  # height of a standing ankle
        eye_height = rest[index["head_top"], 1] - rest[ankles, 1].min() + sole
        heights[subject].append(eye_height)
        head = turns[:, index["head"]]
        eyes = at[:, index["head_top"]] + head @ [0, 0, EYES_AHEAD]
        pelvis = at[:, 0, 1] / (rest[0, 1] - rest[ankles, 1].min() + sole)
        upright = (pelvis > TALL) & (pelvis < TALLEST) & (turns[:, index["spine3"], 1, 1] > CHEST)
        upright &= eyes[:, 1] < 1.06 * eye_height
        hands = at[:, [index["l_wrist"], index["r_wrist"]]] - eyes[:, None]
        for first, last in _runs(upright):
            if last - first >= RATE:
                some = slice(first, last)
                pace = np.linalg.norm(np.gradient(eyes[some][:, [0, 2]], axis=0), axis=-1).mean() * RATE
                parts[subject].append(Part(float(pace), eyes[some], matrix_quaternions(head[some]), hands[some]))
    return {name: Person(float(np.median(tall)), tuple(parts[name])) for name, tall in heights.items()}


def forward(quats: NDArray[np.int16], parents: Array, offsets: Array) -> tuple[Array, Array]:
    """Return world rotations [T, J, 3, 3] of local ones, wxyz [T, J, 4] of any length, and rest positions [J, 3].

    Parents may come after children.
    """
    unit = quats.astype(float)
    local = quaternion_matrices(unit / np.linalg.norm(unit, axis=-1, keepdims=True))
    turns, rest = np.array(local), np.zeros((len(parents), 3))
    todo = set(range(len(parents)))
    while todo:
        for i in [i for i in todo if parents[i] not in todo]:
            if parents[i] >= 0:
                turns[:, i] = turns[:, parents[i]] @ local[:, i]
                rest[i] = rest[parents[i]] + offsets[i]
            todo.remove(i)
    return turns, rest


def _runs(mask: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(int), [0]))))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _began(start: str, person: Person, scale: float, stood: Part, rng: np.random.Generator) -> Part:
    """Return a scaled session that begins with ``start``, a key of STARTS."""
    seconds = STARTS[start]
    stood = Part(0.0, stood.eyes * scale, stood.head, stood.hands * scale)
    if not seconds:
        return stood
    still, rises = round(seconds * RATE), round(RISES * RATE)
    stature = person.eye_height / EYES_OF_STATURE * scale
    low = 0.45 + 0.45 * stature if start.startswith("seated") else 0.72 * person.eye_height * scale
    eyes = rng.normal(0, 0.0006, (still + rises, 3)).cumsum(0) + [0, low, 0]
    t = np.linspace(0, 1, rises)
    eyes[still:, 1] += (stood.eyes[0, 1] - low) * t * t * (3 - 2 * t)
    hands = stood.hands[np.arange(still + rises) % len(stood.hands)].copy()
    if start.startswith("seated"):
        drop, ahead = ((0.37 * stature + 0.06, 0.26), (0.30 * stature, 0.30))[int(rng.integers(2))]
        place = np.array([[0.16, -drop, ahead], [-0.16, -drop, ahead]])
        hands[:still] = place + rng.normal(0, 0.001, (still, 2, 3)).cumsum(0)
    head = np.repeat([[1.0, 0, 0, 0]], still + rises, 0)
    return Part(0.0, *[np.concatenate(both) for both in ((eyes, stood.eyes), (head, stood.head), (hands, stood.hands))])


def found(people: dict[str, Person]) -> dict[str, list[Found]]:
    """Return results by start, of everybody who has such a session, at every scale."""
    body, rng = Body.of(default_avatar().skeleton), np.random.default_rng(0)
    out: dict[str, list[Found]] = defaultdict(list)
    for subject, person in people.items():
        for scale in SCALES:
            true = person.eye_height * scale / body.eye_height
            for start in STARTS:
                stood = person.session(start == "mid-walk")
                if stood is None:
                    continue
                whole = _began(start, person, scale, stood, rng)
                finder, off = BodySizeFinder(body, 1.0), []
                for eye, head, hands in zip(whole.eyes.tolist(), whole.head.tolist(), whole.hands, strict=True):
                    finder.update(tuple(eye), tuple(head), [tuple(hand) for hand in (hands + eye).tolist()], 1 / RATE)
                    off.append(finder.scale / true - 1)
                asked = min(len(whole.eyes) - len(stood.eyes) + round(ASKED * RATE), len(off) - 1)
                without = abs(1 / true - 1)
                out[start].append(Found(subject, scale, off[asked], float(np.abs(off[90:]).max() - without)))
    return out


def table(results: dict[str, list[Found]]) -> str:
    """Return a Markdown table with a row per start."""
    lines = [
        "| start | sessions | within 3 % | off, median | worst | worse than without, after 3 s, by more than 1 % |",
        "|---|--:|--:|--:|--:|---|",
    ]
    for start, sessions in results.items():
        off = np.abs([one.off for one in sessions])
        worse = [f"{one.subject} x {one.scale:g} ({100 * one.worse:.0f} %)" for one in sessions if one.worse > 0.01]
        lines.append(
            f"| {start} | {len(off)} | {100 * np.mean(off < 0.03):.0f} % | {100 * np.median(off):.1f} % "
            f"| {100 * off.max():.0f} % | {', '.join(worse) or 'none'} |"
        )
    missed = sorted({f"{one.subject} x {one.scale:g}" for s in results.values() for one in s if abs(one.off) >= 0.03})
    return "\n".join([*lines, "", f"Beyond 3 %: {', '.join(missed) or 'none'}."])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pack", type=Path)
    parser.add_argument("--subjects", default="", metavar="REGEX", help="only these subjects")
    arguments = parser.parse_args()
    wanted = [
        path for path in arguments.pack.glob("*.npz") if re.search(arguments.subjects, path.stem.rsplit("_", 1)[0])
    ]
    print(table(found(persons(wanted))))
