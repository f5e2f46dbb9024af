"""``glsplat tracking show``: draw the solved avatar from the side, with targets and joints."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera, look_at, pinhole
from glsplat.data import default_avatar
from glsplat.extras.evaluate.tracking_score import baseline
from glsplat.extras.formats.npz import array_names
from glsplat.extras.motions.derive import derive, truth_from_motion, with_expressions
from glsplat.io.files import open_regular
from glsplat.scene import Rigged
from glsplat.skinning.pose import Pose
from glsplat.tracking.sample import Sample
from glsplat.tracking.tracker import Tracker

from ..args import load_avatar, motion_of, not_negative, positive, size
from ..clip import CLIPS, Clip
from ..output import label, save_png, stack
from ..progress import each
from ..usage import UsageError, output_kind
from .options import add_recording, read_poses, samples_of, skeleton_of, tracker_of

Image = NDArray[np.uint8]

Colour = tuple[int, int, int]
BONE, TARGET, MISSED, TRUE, NAIVE = (255, 210, 60), (80, 230, 120), (255, 80, 80), (150, 150, 255), (150, 110, 90)
BACKGROUND = (0.16, 0.17, 0.19)
TILES = 10  # moments on a contact sheet


def add_show(commands: Any) -> None:
    """Add the options of the subcommand."""
    command = commands.add_parser("show", help="pictures of the solved avatar with targets and joints over it")
    add_recording(command)
    command.add_argument(
        "-o", "--output", required=True, metavar="OUT", help="folder/, clip .mp4 or .webm (VP9), contact sheet .png"
    )
    command.add_argument("--truth", metavar="JSONL", help="draw these poses too (from-motion --truth)")
    command.add_argument(
        "--motion",
        metavar="MOTION",
        help="head and hands of this motion instead of a recording, with its truth and the naive baseline",
    )
    command.add_argument("--rate", type=positive, default=72.0, help="samples a second of --motion (default 72)")
    command.add_argument("--from", dest="first", type=not_negative, default=0.0, help="first second that is drawn")
    command.add_argument("--seconds", type=positive, help="that are drawn (default: all)")
    command.add_argument("--size", type=size, default=(512, 512), help="pixels of a view (default 512x512)")
    command.add_argument("--fps", type=positive, default=24.0, help="pictures a second of the recording (default 24)")
    command.add_argument("--side", type=float, default=60.0, help="degrees from the front the camera stands")
    command.add_argument("--stick", action="store_true", help="joints only, no avatar (needs no OpenGL)")
    command.set_defaults(work=show)


def show(args: argparse.Namespace) -> int:
    """Solve, draw, save."""
    target = Path(args.output)
    what = "a clip .mp4 or .webm, a contact sheet .png"
    kind = output_kind("-o", args.output, (*CLIPS, ".png"), what, folder="PNG files")
    if args.motion and (args.recording or args.truth):
        raise UsageError("--motion has its own head, hands and truth; leave the recording and --truth out")
    skeleton = skeleton_of(args.avatar)
    tracker = tracker_of(args, skeleton)
    others: list[tuple[NDArray[np.float64], Colour]] = []
    if args.motion:
        motion = motion_of(args.motion, skeleton)
        truth = truth_from_motion(skeleton, motion.rotations, motion.trans, motion.fps, args.rate)
        samples = with_expressions(derive(skeleton, truth), motion)
        others = [(baseline(truth, "naive"), NAIVE), (truth.positions, TRUE)]
    else:
        samples = samples_of(args.recording)
        if args.truth:
            others = [(read_poses(args.truth).joints, TRUE)]
    if max(args.size) > 4096 or args.fps > 1000:
        raise UsageError("--size needs at most 4096 a side and --fps at most 1000")
    samples, part = _until(samples, args.first, args.seconds)
    frames = {part + i for i in _chosen(samples[part:], args.fps, TILES if kind == ".png" else None)}
    painter = Painter(args, tracker, others)
    bar = each(enumerate(samples), "samples", total=len(samples))
    pictures: list[Image] = []
    with painter as draw:
        if kind in CLIPS:
            with Clip(target, args.fps) as clip:
                for index, sample in bar:
                    pose = tracker.update(sample)
                    if index in frames:
                        clip.add(draw(index, sample, pose))
        else:
            if kind == "":
                target.mkdir(parents=True, exist_ok=True)
            for index, sample in bar:
                pose = tracker.update(sample)
                if index in frames and kind == "":
                    save_png(target / f"{index:06d}.png", draw(index, sample, pose))
                elif index in frames:
                    pictures.append(draw(index, sample, pose))
    if pictures:
        save_png(target, stack([pictures[i : i + 5] for i in range(0, len(pictures), 5)]))
    print(clip.summary if kind in CLIPS else args.output)
    return 0


def _until(samples: list[Sample], first: float, seconds: float | None) -> tuple[list[Sample], int]:
    """Return the samples up to the last drawn one, and the index of the first drawn one; all are solved."""
    since = [sample.t - samples[0].t for sample in samples]
    part = next((i for i, t in enumerate(since) if t >= first - 1e-6), len(samples))
    end = next((i for i, t in enumerate(since) if seconds is not None and t > first + seconds), len(samples))
    if part >= end:
        raise UsageError(f"--from {first:g}: there are {since[-1]:.1f} s; nothing is left to draw")
    return samples[:end], part


def _chosen(samples: list[Sample], fps: float, count: int | None) -> set[int]:
    """Return the indices of the drawn samples: ``count`` evenly spaced, or one per 1/fps seconds."""
    if count is not None:
        return {round(i * (len(samples) - 1) / max(count - 1, 1)) for i in range(count)}
    chosen, due = set(), -np.inf
    for index, sample in enumerate(samples):
        if sample.t >= due:
            chosen.add(index)
            due = max(due + 1 / fps, sample.t) if np.isfinite(due) else sample.t + 1 / fps
    return chosen


class Painter:
    """Draws the avatar from the side, if there is one, with lines over it."""

    def __init__(
        self, args: argparse.Namespace, tracker: Tracker, others: list[tuple[NDArray[np.float64], Colour]]
    ) -> None:
        self.args, self.tracker = args, tracker
        self.others = others  # other bodies [T, 55, 3] to be drawn, in the world
        self.avatar = None if args.stick else self._avatar(args.avatar)
        self.renderer: Any = None

    @staticmethod
    def _avatar(name: str | None) -> Rigged | None:
        if name is None:
            return default_avatar()
        if name.endswith(".npz"):
            with open_regular(name) as (file, _):
                if "part_names" not in array_names(file):
                    return None  # a body without textures
        return load_avatar(name, "--avatar")

    def __enter__(self) -> Callable[[int, Sample, Pose], Image]:
        if self.avatar is not None:
            from glsplat.renderer import Renderer

            self.renderer = Renderer(self.avatar, size=self.args.size, views=1)
        return self.picture

    def __exit__(self, *_: object) -> None:
        if self.renderer is not None:
            self.renderer.release()

    def picture(self, index: int, sample: Sample, pose: Pose) -> Image:
        """Return the picture [H, W, 3] of a moment."""
        tracker = self.tracker
        joints = tracker.skeleton.forward(pose.rotations, pose.trans)[:, :3, 3]
        middle = np.array([joints[0, 0], 0.52 * tracker.body.eye_height, joints[0, 2]])
        camera = self._camera(middle)
        if self.renderer is not None:
            image: Image = np.ascontiguousarray(self.renderer.render([camera], pose)[0, ..., :3])
        else:
            shade = [round(255 * v) for v in BACKGROUND]
            image = np.full((camera.height, camera.width, 3), shade, np.uint8)
        scale, floor = tracker.calibration.scale, tracker.calibration.floor
        for body, colour in self.others:
            self._bones(image, camera, (body[min(index, len(body) - 1)] - (0, floor, 0)) / scale, colour)
        self._bones(image, camera, joints, BONE)
        self._targets(image, camera, sample)
        planted = "".join(s[0].upper() for s in ("left", "right") if f"{s}_planted" in tracker.flags) or "-"
        return label(image, f"{sample.t:.2f} s  feet {planted}")

    def _camera(self, middle: NDArray[np.float64]) -> Camera:
        angle = np.radians(self.args.side)
        eye = middle + 3.4 * np.array([np.sin(angle), 0.12, np.cos(angle)])
        width, height = self.args.size
        return Camera(look_at(eye, middle), pinhole(width, height, 40.0), width, height, background=BACKGROUND)

    def _bones(self, image: Image, camera: Camera, joints: NDArray[np.float64], colour: Colour) -> None:
        pixels = _project(camera, joints)
        for joint in range(1, 22):
            parent = int(self.tracker.skeleton.parents[joint])
            cv2.line(image, pixels[joint], pixels[parent], colour, 1, cv2.LINE_AA)

    def _targets(self, image: Image, camera: Camera, sample: Sample) -> None:
        tracker = self.tracker
        for name, pose in (("head", sample.head), ("left", sample.left), ("right", sample.right)):
            if pose is None or not np.isfinite(pose).all() or (name != "head" and tracker.head_only):
                continue
            at = tracker.to_avatar(np.block([[np.eye(3), np.array(pose[:3])[:, None]], [np.zeros(3), 1.0]]))[:3, 3]
            colour = MISSED if f"{name}_out_of_reach" in tracker.flags else TARGET
            cv2.circle(image, _project(camera, at[None])[0], max(3, camera.height // 90), colour, 2, cv2.LINE_AA)


def _project(camera: Camera, points: NDArray[np.float64]) -> list[tuple[int, int]]:
    seen = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    pixels = seen @ camera.K.T
    pixels = pixels[:, :2] / np.maximum(pixels[:, 2:], 1e-3)
    return [(int(x), int(y)) for x, y in np.clip(np.rint(pixels), -9999, 9999)]
