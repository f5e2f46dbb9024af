"""``glsplat avatar score``: an avatar against the textured mesh it was made from, in poses the fit has not seen."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from apps.output import eight_bit, label, save_png, stack
from apps.usage import UsageError
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.config import RenderConfig
from glsplat.errors import FormatError
from glsplat.evaluate.avatar_poses import SCORE_POSES, score_pose
from glsplat.formats.files import replace_file
from glsplat.mesh import MeshConfig, MeshRenderer
from glsplat.meshes import RiggedMesh
from glsplat.renderer import Renderer

__all__ = ["Score", "add_arguments", "compare", "report", "score"]

F64 = NDArray[np.float64]

DISTANCE = 3.0  # metres from the middle of the figure
FILL = 0.94  # of the picture the figure takes, in its longer direction
FIRST, LIFT = 15.0, 8.0  # degrees: azimuth of the first view, elevation of all
HAND = ("wrist", "index", "middle", "pinky", "ring", "thumb")


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """One pose in one view: the figures, and the pictures they come from."""

    pose: str
    azimuth: float  # degrees, 0 is the front, growing towards the left hand
    body: float  # dB over the box around the figure
    hands: float | None  # dB over the boxes around both hands; None for a rig without them
    ssim: float  # over the box around the figure
    milliseconds: float  # to render the avatar's picture and read it back
    avatar: NDArray[np.float32]  # [H, W, 3] in [0, 1]
    mesh: NDArray[np.float32]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the subcommand."""
    parser.add_argument("avatar", type=Path, nargs="?", help="avatar (.glb); default: the embedded avatar")
    parser.add_argument("--mesh", type=Path, required=True, help="the rigged, textured mesh it shows (.npz, .glb)")
    parser.add_argument("--poses", type=int, default=len(SCORE_POSES), help=f"poses (default {len(SCORE_POSES)})")
    parser.add_argument("--views", type=int, default=4, help="views a pose, evenly around (default 4)")
    parser.add_argument("--size", type=int, default=512, help="pixels, square (default 512)")
    parser.add_argument(
        "--antialias",
        action=argparse.BooleanOptionalAction,
        help="draw the avatar with opacity compensation (default: what the file asks for)",
    )
    parser.add_argument("--grey", type=float, default=0.0, help="background, 0 black (default) to 1 white")
    parser.add_argument("--sheet", type=Path, help="contact sheet to write (.png, .jpg): avatar, mesh, 4 x difference")
    parser.add_argument("--json", action="store_true", help="print the figures of every picture as JSON")


def report(args: argparse.Namespace, avatar: Avatar, mesh: RiggedMesh) -> int:
    """Score, print, write the sheet; 0 on success."""
    if not 1 <= args.poses <= len(SCORE_POSES):
        raise UsageError(f"--poses needs 1 to {len(SCORE_POSES)}, not {args.poses}")
    if not 1 <= args.views <= 360:
        raise UsageError(f"--views needs 1 to 360, not {args.views}")
    if not 32 <= args.size <= 4096:
        raise UsageError(f"--size needs 32 to 4096, not {args.size}")
    if not 0 <= args.grey <= 1:
        raise UsageError(f"--grey needs 0 to 1, not {args.grey}")
    if args.sheet is not None and args.sheet.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise UsageError(f"{args.sheet}: a contact sheet is written as .png or .jpg; change the name")
    names = list(SCORE_POSES)[: args.poses]
    with MeshRenderer(mesh, size=(args.size,) * 2, config=MeshConfig(output="float32")) as truth:
        config = RenderConfig(output="float32", antialias=args.antialias)
        with Renderer(avatar, size=(args.size,) * 2, config=config, context=truth.context) as renderer:
            scores = list(score(renderer, truth, avatar, mesh, names, args.views, args.grey))
            driver = renderer.driver
    if args.sheet is not None:
        _write_sheet(args.sheet, scores, args.views)
    body, ssim = np.array([s.body for s in scores]), np.array([s.ssim for s in scores])
    hands = np.array([s.hands for s in scores if s.hands is not None])
    facts = {
        "splats": len(avatar.splats),
        "driver": driver,
        "antialias": avatar.splats.antialias if args.antialias is None else args.antialias,
        "size": args.size,
        "pictures": len(scores),
        "body_psnr": _summary(body),
        "hands_psnr": _summary(hands) if len(hands) else None,
        "ssim": _summary(ssim, 4),
        "milliseconds": round(float(np.median([s.milliseconds for s in scores])), 2),
    }
    if args.json:
        each = [
            {"pose": s.pose, "azimuth": s.azimuth, "body_psnr": s.body, "hands_psnr": s.hands, "ssim": s.ssim}
            for s in scores
        ]
        print(json.dumps({**facts, "each": each}))
        return 0
    print(f"{len(avatar.splats)} splats, {args.poses} poses x {args.views} views at {args.size}^2, {driver}")
    for name in names:
        mine = [s for s in scores if s.pose == name]
        worst = min(s.hands if s.hands is not None else np.nan for s in mine)
        print(
            f"  {name:18} body {min(s.body for s in mine):5.1f} dB  hands {worst:5.1f} dB  "
            f"SSIM {min(s.ssim for s in mine):.4f}  (worst view)"
        )
    print(
        f"body: {body.min():.1f} dB at worst, {body.mean():.1f} mean; SSIM {ssim.min():.4f}, {ssim.mean():.4f}", end=""
    )
    print(f"; hands {hands.min():.1f}, {hands.mean():.1f} dB" if len(hands) else "", end="")
    print(f"; {facts['milliseconds']} ms a picture (median)")
    return 0


def _summary(values: F64, digits: int = 2) -> dict[str, float]:
    return {"min": round(float(values.min()), digits), "mean": round(float(values.mean()), digits)}


def score(
    renderer: Renderer,
    truth: MeshRenderer,
    avatar: Avatar,
    mesh: RiggedMesh,
    names: list[str],
    views: int,
    grey: float = 0.0,
) -> Iterator[Score]:
    """Every pose in every view; both renderers have one square size and give float32."""
    if avatar.skeleton.names != mesh.skeleton.names:
        raise FormatError(
            f"the avatar has {len(avatar.skeleton)} joints from {avatar.skeleton.names[0]}, the mesh "
            f"{len(mesh.skeleton)} from {mesh.skeleton.names[0]}; score against the mesh it was made from"
        )
    used = np.unique(mesh.faces)
    strongest = np.take_along_axis(mesh.joints, mesh.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    hands = []
    for side in ("left", "right"):
        owns = np.array([joint.startswith(tuple(f"{side}_{part}" for part in HAND)) for joint in mesh.skeleton.names])
        hands.append(used[owns[strongest[used]]])
    for name in names:
        pose = score_pose(name, mesh.skeleton)
        vertices = mesh.posed(pose)
        for view in range(views):
            azimuth = FIRST + 360 * view / views
            camera = camera_around(vertices[used], azimuth, renderer.size[0], grey)
            picture = np.clip(renderer.render([camera], pose)[0, ..., :3], 0, 1)
            milliseconds = renderer.timings["total"]
            wanted = np.clip(truth.render([camera], pose)[0, ..., :3], 0, 1)
            boxes = [_box(vertices[hand], camera) for hand in hands if len(hand)]
            body, fingers, ssim = compare(picture, wanted, _box(vertices[used], camera), boxes)
            yield Score(name, azimuth % 360, body, fingers, ssim, milliseconds, picture, wanted)


def camera_around(points: F64, azimuth: float, size: int, grey: float = 0.0) -> Camera:
    """A camera DISTANCE away that the figure ``points`` [N, 3] just fills."""
    centre = (points.max(axis=0) + points.min(axis=0)) / 2
    turn, lift = np.radians((azimuth, LIFT))
    direction = np.array([np.cos(lift) * np.sin(turn), np.sin(lift), np.cos(lift) * np.cos(turn)])
    viewmat = look_at(centre + DISTANCE * direction, centre)
    seen = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    half = np.abs(seen[:, :2] / np.maximum(seen[:, 2:], 0.1)).max()
    fov = 2 * np.degrees(np.arctan(min(float(half) / FILL, 2.0)))
    return Camera(viewmat, pinhole(size, size, float(fov)), size, size, background=(grey,) * 3)


def _box(points: F64, camera: Camera) -> tuple[slice, slice]:
    """Rows and columns that hold ``points`` [N, 3], and two pixels around them for what blurs outwards."""
    seen = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    pixel = (seen @ camera.K.T)[:, :2] / np.maximum(seen[:, 2:], 1e-6)
    low = np.clip(np.floor(pixel.min(axis=0)) - 2, 0, camera.width - 8).astype(int)
    high = np.clip(np.ceil(pixel.max(axis=0)) + 2, low + 8, camera.width).astype(int)
    return slice(low[1], high[1]), slice(low[0], high[0])


def compare(
    picture: NDArray[np.float32],
    wanted: NDArray[np.float32],
    body: tuple[slice, slice],
    hands: list[tuple[slice, slice]],
) -> tuple[float, float | None, float]:
    """PSNR over ``body``, PSNR over ``hands`` taken together, SSIM over ``body``, of pictures [H, W, 3] in [0, 1].

    SSIM as in Wang et al. 2004: Gaussian window of 11 pixels and sigma 1.5, K1 = 0.01, K2 = 0.03, a channel at a time,
    on the whole picture, then averaged over the box.
    """
    square = (picture.astype(np.float64) - wanted) ** 2
    ssim = cv2.quality.QualitySSIM.create(255 * wanted)  # its constants are those of 8 bits
    ssim.compute(255 * picture)
    local = np.asarray(ssim.getQualityMap())
    inside = [square[box].reshape(-1) for box in hands]
    fingers = _decibel(np.concatenate(inside)) if inside else None
    return _decibel(square[body]), fingers, float(local[body][..., :3].mean())


def _decibel(square: F64) -> float:
    return float(-10 * np.log10(max(float(square.mean()), 1e-12)))


def _write_sheet(path: Path, scores: list[Score], views: int) -> None:
    """A row a pose, for each view the avatar, the mesh and four times their difference, at half size."""
    rows = []
    for first in range(0, len(scores), views):
        row = []
        for s in scores[first : first + views]:
            hands = "" if s.hands is None else f", hands {s.hands:.1f}"
            text = f"{s.pose}: {s.body:.1f}{hands} dB, {s.ssim:.3f}"
            for picture, words in (
                (s.avatar, text),
                (s.mesh, "mesh"),
                (4 * np.abs(s.avatar - s.mesh), "4 x difference"),
            ):
                size = (picture.shape[1] // 2, picture.shape[0] // 2)
                row.append(label(eight_bit(cv2.resize(picture, size, interpolation=cv2.INTER_AREA)), words))
        rows.append(row)
    sheet = stack(rows, 2)
    if path.suffix.lower() == ".png":
        save_png(path, sheet)
    else:
        data = simplejpeg.encode_jpeg(np.ascontiguousarray(sheet), 88, "RGB", "444")
        replace_file(path, [data])
