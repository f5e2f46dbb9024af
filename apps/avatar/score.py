"""``glsplat avatar score``: compare an avatar with the mesh it was made from, in poses outside the fit."""

from __future__ import annotations

import argparse
import json
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import simplejpeg

from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.config import RenderConfig
from glsplat.data import default_avatar, embedded_file
from glsplat.errors import FormatError
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.evaluate.avatar_score import SCORE_POSES, AvatarScore, score
from glsplat.formats import load_splats
from glsplat.io.files import replace_file
from glsplat.meshes import RiggedMesh
from glsplat.renderer import Renderer
from glsplat.skinning.driven import why_not_driven

from ..args import Number, add_detail, detail_of, whole
from ..output import eight_bit, label, save_png, stack
from ..usage import UsageError
from .person import read_any_person


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("avatar", type=Path, nargs="?", help="avatar (.glb); default: the embedded avatar")
    parser.add_argument("--mesh", type=Path, required=True, help="the rigged, textured mesh it shows (.npz, .glb)")
    parser.add_argument(
        "--poses", type=whole(1, len(SCORE_POSES)), default=len(SCORE_POSES), help=f"poses (default {len(SCORE_POSES)})"
    )
    parser.add_argument("--views", type=whole(1, 360), default=4, help="views per pose, evenly around (default 4)")
    parser.add_argument("--size", type=whole(32, 4096), default=512, help="pixels, square (default 512)")
    parser.add_argument(
        "--antialias",
        action=argparse.BooleanOptionalAction,
        help="draw the avatar with opacity compensation (default: as the file says)",
    )
    add_detail(parser, lean=False)
    parser.add_argument("--grey", type=Number(0, 1), default=0.0, help="background, 0 black (default) to 1 white")
    parser.add_argument("--sheet", type=Path, help="contact sheet to write (.png, .jpg): avatar, mesh, 4 x difference")
    parser.add_argument("--json", action="store_true", help="print the figures of every picture as JSON")


def run(args: argparse.Namespace) -> int:
    """Load avatar and mesh, and report."""
    scene = default_avatar() if args.avatar is None else load_splats(embedded_file(args.avatar))
    if not isinstance(scene, Avatar):
        raise FormatError(f"{args.avatar}: has no skeleton to pose; give an avatar (.glb with a skin)")
    if why := why_not_driven(scene.skeleton):
        raise FormatError(f"{args.avatar}: the poses that are scored cannot drive this avatar: {why}")
    return report(args, scene, read_any_person(args.mesh))


def report(args: argparse.Namespace, avatar: Avatar, mesh: RiggedMesh) -> int:
    """Print the scores and write the sheet; 0 on success."""
    if args.sheet is not None and args.sheet.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise UsageError(f"{args.sheet}: a contact sheet is written as .png or .jpg; change the name")
    names = list(SCORE_POSES)[: args.poses]
    with MeshTruth(mesh, size=(args.size,) * 2, output="float32") as truth:
        exact = RenderConfig(output="float32", antialias=args.antialias)
        less = replace(exact, **detail_of(args))
        with ExitStack() as opened:
            renderer, finest = (
                opened.enter_context(Renderer(avatar, size=(args.size,) * 2, config=config, context=truth.context))
                for config in (less, exact)
            )
            whole = None if less == exact else finest
            scores = list(score(renderer, truth, avatar, mesh, names, args.views, args.grey, whole))
            driver, drawn = renderer.driver, renderer.stats
    if args.sheet is not None:
        _write_sheet(args.sheet, scores, args.views)
    body, ssim = np.array([s.body for s in scores]), np.array([s.ssim for s in scores])
    hands = np.array([s.hands for s in scores if s.hands is not None])
    face = np.array([s.face for s in scores if s.face is not None])
    whole_psnr = np.array([s.finest for s in scores if s.finest is not None])
    facts = {
        "splats": drawn.splats,
        "levels": drawn.levels,
        "drawn": drawn.drawn,
        "driver": driver,
        "antialias": avatar.splats.antialias if args.antialias is None else args.antialias,
        "size": args.size,
        "pictures": len(scores),
        "body_psnr": _summary(body),
        "hands_psnr": _summary(hands) if len(hands) else None,
        "face_psnr": _summary(face) if len(face) else None,
        "finest_psnr": _summary(whole_psnr) if len(whole_psnr) else None,
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
    print(f"{drawn.splats} splats, {args.poses} poses x {args.views} views at {args.size}^2, {driver}")
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
    print(f"; face {face.min():.1f}, {face.mean():.1f} dB" if len(face) else "", end="")
    print(f"; {facts['milliseconds']} ms a picture (median)")
    if len(whole_psnr):
        print(
            f"against the finest level drawn exactly: {whole_psnr.min():.1f} dB at worst, {whole_psnr.mean():.1f} mean"
        )
    return 0


def _summary(values: F64, digits: int = 2) -> dict[str, float]:
    return {"min": round(float(values.min()), digits), "mean": round(float(values.mean()), digits)}


def _write_sheet(path: Path, scores: list[AvatarScore], views: int) -> None:
    """Write a row per pose: for each view the avatar, the mesh and four times their difference, at half size."""
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
