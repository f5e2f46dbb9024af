"""Score estimated motions against the truth (conventions of AvatarPoser and its successors, docs/tracking.md).

Two baselines that a solver has to beat give positions only: the template glued to the head, and naive inverse
kinematics. Unless they begin from the rest pose, both get the true body of the first frame, which no headset knows.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import PoseError
from glsplat.extras.learned.network import PoseNetwork, embedded_network
from glsplat.extras.learned.solver import LearnedSolver
from glsplat.extras.motions.derive import TrueMotion, derive, forward_all, truth_from_motion
from glsplat.motion.motion import Motion
from glsplat.rotations import rotation_matrices, unit_vectors
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.config import TrackerConfig
from glsplat.tracking.solve.body import FEET, HEAD, NECK, PELVIS, SPINE1, SPINE2, SPINE3, WRISTS, Body
from glsplat.tracking.solve.solver import AnalyticSolver
from glsplat.tracking.tracker import Tracker

Array = NDArray[np.float64]

BODY = slice(0, 22)  # the 22 joints of SMPL that the literature scores
LOWER = (1, 2, 4, 5, 7, 8, 10, 11)
UPPER = (3, 6, 9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21)
WINDOW = 10.0  # seconds of a part, to find the part with the largest mean error
CONTACT = 0.02  # metres above the flat ground up to which the ball of a foot counts as planted

_ARMS = ((13, 16, 18, 20), (14, 17, 19, 21))
_LEGS = ((1, 4, 7, 10), (2, 5, 8, 11))
_FINGERS = (range(25, 40), range(40, 55))

BASELINES = ("glued", "naive", "naive, untold")
SOLVERS = (*BASELINES, "analytic", "learned", "learned, head only")


@dataclass(frozen=True, slots=True)
class TrackingScore:
    """Errors in cm, cm/s and degrees; jitter (mean third derivative) in 100 m/s^3."""

    frames: int
    mpjpe: float  # 22 body joints
    upper: float
    lower: float
    root: float
    hands: float  # both wrists
    fingers: float  # the 30 finger joints
    mpjre: float  # local rotations of the 22 body joints; NaN without rotations
    mpjve: float
    jitter: float
    jitter_truth: float
    skate: float  # mean speed of the ball of a foot over the ground while it is planted
    skate_truth: float
    penetration: float  # mean depth of the lowest sole under the floor

    def to_json(self) -> dict[str, float | None]:
        """Return a JSON object; unknown values are null."""
        return {k: None if v != v else v for k, v in asdict(self).items()}


def score(
    positions: Array,  # [T, 55, 3] estimated joints, metres
    truth: Array,  # [T, 55, 3]
    rate: float,  # Hz
    sole: float,  # metres from the foot joint to the ground
    rotations: Array | None = None,  # [T, 55, 3] axis-angle
    true_rotations: Array | None = None,
) -> TrackingScore:
    """Compare two motions frame by frame. Raises PoseError for different shapes or fewer than 4 frames."""
    if positions.shape != truth.shape or positions.shape[1:] != (55, 3):
        raise PoseError(f"poses and truth need one shape (T, 55, 3), not {positions.shape} and {truth.shape}")
    if len(positions) < 4:
        raise PoseError(f"a score needs at least 4 frames, not {len(positions)}")
    error = np.linalg.norm(positions - truth, axis=-1) * 100
    velocity = np.linalg.norm(np.diff(positions - truth, axis=0), axis=-1) * rate * 100
    angle = float("nan")
    if rotations is not None and true_rotations is not None:
        ours, theirs = (rotation_matrices(r[:, BODY]) for r in (rotations, true_rotations))
        trace = np.einsum("tjab,tjab->tj", ours, theirs)
        angle = float(np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1))).mean())
    feet = positions[:, list(FEET)]
    return TrackingScore(
        frames=len(positions),
        mpjpe=float(error[:, BODY].mean()),
        upper=float(error[:, UPPER].mean()),
        lower=float(error[:, LOWER].mean()),
        root=float(error[:, 0].mean()),
        hands=float(error[:, WRISTS].mean()),
        fingers=float(error[:, 25:].mean()),
        mpjre=angle,
        mpjve=float(velocity[:, BODY].mean()),
        jitter=_jitter(positions, rate),
        jitter_truth=_jitter(truth, rate),
        skate=_skate(feet, sole, rate),
        skate_truth=_skate(truth[:, list(FEET)], sole, rate),
        penetration=float(np.maximum(sole - feet[..., 1].min(1), 0).mean() * 100),
    )


def windows(positions: Array, truth: Array, rate: float) -> tuple[float, ...]:
    """Return MPJPE in cm over equal parts of at least WINDOW seconds, or over the whole of a shorter motion."""
    error = np.linalg.norm(positions - truth, axis=-1)[:, BODY].mean(1) * 100
    return tuple([float(part.mean()) for part in np.array_split(error, max(1, int(len(error) / (WINDOW * rate))))])


def mean_score(scores: list[TrackingScore]) -> TrackingScore:
    """Return the mean over clips, weighted by their frames; NaN stays NaN."""
    weights = np.array([s.frames for s in scores], np.float64)
    values = np.array([list(asdict(s).values()) for s in scores], np.float64)
    mean = (values * weights[:, None]).sum(0) / weights.sum()
    return TrackingScore(int(weights.sum()), *mean[1:].tolist())


def _jitter(positions: Array, rate: float) -> float:
    third = np.diff(positions[:, BODY], n=3, axis=0) * rate**3
    return float(np.linalg.norm(third, axis=-1).mean() / 100)


def _skate(feet: Array, sole: float, rate: float) -> float:
    """Return the mean horizontal speed (cm/s) of the balls of the feet between two frames with ground contact."""
    low = feet[..., 1] < sole + CONTACT
    speed = np.linalg.norm(np.diff(feet[..., [0, 2]], axis=0), axis=-1) * rate * 100
    planted = low[1:] & low[:-1]
    return float(speed[planted].mean()) if planted.any() else 0.0


def baseline(truth: TrueMotion, kind: Literal["glued", "naive"], rest: Body | None = None) -> Array:
    """Return joint positions [T, 55, 3], metres, world frame, estimated from the true head and wrists.

    glued: the body of the first frame hangs on the head, turned by a smoothed head yaw, with wrists at the hands.
    naive: a yaw follower, a torso of fixed length under the head, two-bone arms with an elbow guessed from a straight
    wrist, and feet that step with the pelvis. ``rest``: a body whose rest pose replaces the first frame.
    """
    solver = _Naive(truth, rest)
    return np.stack([solver.frame(k, kind) for k in range(len(truth.times))])


class _Naive:
    def __init__(self, truth: TrueMotion, rest: Body | None) -> None:
        self.truth, self.dt = truth, float(truth.times[1] - truth.times[0])
        first, frames = truth.positions[0], truth.frames[0]
        if rest is not None:
            first, frames = rest.rest - [0.0, rest.ground, 0.0], np.broadcast_to(np.eye(3), frames.shape)
        across = first[1] - first[2]
        self.first, self.facing = first, _yaw(np.arctan2(-across[2], across[0]))
        self.template = (first - first[HEAD]) @ self.facing  # in the first frame's heading
        self.head = frames[HEAD]
        self.neck = self.head.T @ (first[NECK] - first[HEAD])
        self.wrists = [frames[arm[3]] for arm in _ARMS]
        self.elbow = [wrist.T @ (first[arm[2]] - first[arm[3]]) for arm, wrist in zip(_ARMS, self.wrists, strict=True)]
        self.yaw = self._head_yaw(0)
        self.velocity = np.zeros(3)
        self.feet: list[Array] = []
        self.steps: list[tuple[Array, float] | None] = [None, None]

    def _ahead(self, k: int) -> Array:
        forward: Array = self.truth.frames[k, HEAD] @ self.head.T @ self.facing @ np.array([0.0, 0.0, 1.0])
        return forward

    def _head_yaw(self, k: int) -> float:
        forward = self._ahead(k)
        return float(np.arctan2(forward[0], forward[2]))

    def frame(self, k: int, kind: str) -> Array:
        truth, template = self.truth, self.template
        head, target = truth.positions[k, HEAD], self._head_yaw(k)
        self.yaw += _wrapped(target - self.yaw) * (1 - np.exp(-self.dt / 0.25))
        behind = _wrapped(target - self.yaw)
        if abs(behind) > 0.9:
            self.yaw += behind - np.sign(behind) * 0.9
        facing = _yaw(self.yaw)
        out: Array = head + template @ facing.T
        if kind == "naive":
            self._body(k, out, head, facing)
        for arm, fingers, wrist in zip(_ARMS, _FINGERS, self.wrists, strict=True):
            out[arm[3]] = truth.positions[k, arm[3]]
            hand = truth.frames[k, arm[3]] @ wrist.T
            out[fingers] = out[arm[3]] + (self.first[fingers] - self.first[arm[3]]) @ hand.T
        return out

    def _body(self, k: int, out: Array, head: Array, facing: Array) -> None:
        truth, template, rest = self.truth, self.template, self.template[PELVIS]
        if k:
            self.velocity = 0.8 * self.velocity + 0.2 * (head - truth.positions[k - 1, HEAD]) / self.dt
            self.velocity[1] = 0
        neck = head + truth.frames[k, HEAD] @ self.neck
        hips = head + facing @ rest
        drop = head[1] - self.first[HEAD, 1]
        pitch = -np.arcsin(np.clip(self._ahead(k)[1], -1, 1))
        if self.feet and np.linalg.norm(self.velocity) < 0.4:
            ankles = (template[7] + template[8]) / 2
            hips[[0, 2]] += 0.35 * ((self.feet[0] + self.feet[1]) / 2 + facing @ (rest - ankles) - hips)[[0, 2]]
        hips[1] = self.first[PELVIS, 1] + min(drop, 0) * (0.5 if pitch > 0.5 else 0.85) + max(drop, 0)
        length = np.linalg.norm(template[NECK] - rest)
        hips = neck - unit_vectors(neck - hips) * length
        torso = _frame(facing[:, 0], neck - hips) @ _frame(np.array([1.0, 0, 0]), template[NECK] - rest).T
        for joint in (PELVIS, SPINE1, SPINE2, SPINE3):
            out[joint] = hips + torso @ (template[joint] - rest)
        out[NECK] = neck
        for side, (collar, shoulder, elbow, wrist) in enumerate(_ARMS):
            for joint in (collar, shoulder):
                out[joint] = neck + torso @ (template[joint] - template[NECK])
            hand = truth.positions[k, wrist]
            a, b = self._length(shoulder, elbow), self._length(elbow, wrist)
            reach = hand - out[shoulder]
            far = float(np.linalg.norm(reach))
            out[shoulder] += unit_vectors(reach) * min(max(far - 0.97 * (a + b), 0.0), 0.08)
            guess = hand + truth.frames[k, wrist] @ self.elbow[side]
            middle = out[shoulder] + reach * a / (a + b)
            down = torso @ np.array([0.5 - side, -1, -0.5])
            out[elbow], _ = _two_bone(
                out[shoulder], hand, a, b, 0.6 * unit_vectors(guess - middle) + 0.4 * unit_vectors(down)
            )
        self._legs(out, hips, facing)

    def _legs(self, out: Array, hips: Array, facing: Array) -> None:
        rest = self.template[PELVIS]
        for side, (hip, knee, ankle, foot) in enumerate(_LEGS):
            out[hip] = hips + facing @ (self.template[hip] - rest)
            target = hips + facing @ (self.template[ankle] - rest) + self.velocity * 0.18
            target[1] = self.first[ankle, 1]
            if len(self.feet) <= side:
                self.feet.append(target.copy())
            step = self.steps[side]
            if step is not None:
                start, phase = step
                phase += self.dt / 0.35
                self.steps[side] = (start, phase) if phase < 1 else None
                e = min(phase, 1.0) ** 2 * (3 - 2 * min(phase, 1.0))
                self.feet[side] = start * (1 - e) + target * e
                self.feet[side][1] = target[1] + (0.1 * np.sin(np.pi * phase) if phase < 1 else 0.0)
            elif np.linalg.norm((target - self.feet[side])[[0, 2]]) > 0.14 and self.steps[1 - side] is None:
                self.steps[side] = (self.feet[side].copy(), 0.0)
            ahead = facing @ np.array([0.1 - 0.2 * side, 0, 1.0])
            a, b = self._length(hip, knee), self._length(knee, ankle)
            out[knee], out[ankle] = _two_bone(out[hip], self.feet[side], a, b, ahead)
            out[foot] = out[ankle] + facing @ (self.template[foot] - self.template[ankle])

    def _length(self, a: int, b: int) -> float:
        return float(np.linalg.norm(self.first[a] - self.first[b]))


def _yaw(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def _frame(across: Array, up: Array) -> Array:
    """Return a rotation [3, 3] with y along ``up`` and x as near to ``across`` as possible."""
    y = unit_vectors(up)
    z = unit_vectors(np.cross(across, y))
    return np.stack([np.cross(y, z), y, z], 1)


def _two_bone(root: Array, end: Array, a: float, b: float, pole: Array) -> tuple[Array, Array]:
    """Return the middle joint and the reachable end."""
    line = unit_vectors(end - root)
    far = float(np.clip(np.linalg.norm(end - root), abs(a - b) + 1e-3, (a + b) * 0.999))
    along = (a * a - b * b + far * far) / (2 * far)
    side = unit_vectors(pole - line * (pole @ line)) * np.sqrt(max(a * a - along * along, 0.0))
    return root + line * along + side, root + line * far


@dataclass(frozen=True)
class Row:
    """Results of one solver on one clip at one rate."""

    clip: str
    rate: float
    solver: str
    score: TrackingScore
    milliseconds: float  # median per sample; NaN: not timed
    windows: tuple[float, ...]  # MPJPE of each ten seconds, cm
    said: float = float("nan")  # mean error of body joints in cm that the solver itself expects; NaN: unknown


def rows_of(
    name: str,
    motion: Motion,
    rate: float,
    skeleton: Skeleton,
    config: TrackerConfig,
    network: PoseNetwork | None = None,
) -> list[Row]:
    """Return a row per solver for one clip at one rate; ``network``: of the learned solver (default: embedded)."""
    truth = truth_from_motion(skeleton, motion.rotations, motion.trans, motion.fps, rate)
    body = Body.of(skeleton)
    sole = body.sole
    nan = float("nan")
    rows = []
    shown = (baseline(truth, "glued"), baseline(truth, "naive"), baseline(truth, "naive", body))
    for kind, estimate in zip(BASELINES, shown, strict=True):
        result = score(estimate, truth.positions, rate, sole)
        rows.append(Row(name, rate, kind, result, nan, windows(estimate, truth.positions, rate)))
    samples = derive(skeleton, truth)
    network = network or embedded_network()
    for name_of in SOLVERS[len(BASELINES) :]:
        solver = AnalyticSolver(body) if name_of == "analytic" else LearnedSolver(body, network)
        tracker = Tracker(skeleton, config=config, head_only=name_of == SOLVERS[-1], solver=solver)
        rotations, trans, spent = np.empty_like(truth.rotations), np.empty_like(truth.trans), []
        said: list[float] = []
        for i, sample in enumerate(samples):
            start = time.perf_counter()
            pose = tracker.update(sample)
            spent.append(time.perf_counter() - start)
            rotations[i], trans[i] = pose.rotations, pose.trans
            said += tracker.expected_error
        positions, _ = forward_all(skeleton, rotations, trans)
        result = score(positions, truth.positions, rate, sole, rotations, truth.rotations)
        worst = windows(positions, truth.positions, rate)
        doubt = float(np.mean(said)) * 100 if said else nan
        rows.append(Row(name, rate, name_of, result, float(np.median(spent)) * 1e3, worst, doubt))
    return rows
