"""``glsplat render``: render a picture, a clip of a motion, or a turntable."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import PAPER_FOV, PAPER_IPD, Camera
from glsplat.config import DebugConfig, RenderConfig
from glsplat.errors import GlsplatError
from glsplat.formats.camera_file import read_cameras
from glsplat.formats.motion_files import KINDS
from glsplat.formats.scene_file import SceneFile
from glsplat.gl.context import create_context
from glsplat.motion.motion import Motion
from glsplat.optional import missing, plugin
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose, load_pose
from glsplat.views import orbited, view_of, viewing_point

from .args import (
    add_detail,
    add_driver,
    add_light,
    add_scene,
    colour,
    degrees,
    detail_of,
    driven,
    expression,
    motion_of,
    not_negative,
    open_scene,
    point,
    positive,
    size,
)
from .clip import CLIPS, Clip
from .output import frame_report, joined_views, save_depth, save_npy, save_png, side_by_side
from .progress import each
from .usage import UsageError, make_folder, output_kind

if TYPE_CHECKING:
    from glsplat.extras.speech.sound import Sound

HELP = (
    "Render a scene or a posed avatar: exact floats to .npy, a picture to .png, a motion or turntable to .mp4 or .webm "
    "(VP9, for browsers)."
)
EXAMPLE = "glsplat render --motion wave-and-turn --frame 40 --stereo -o wave.png"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_scene(parser)
    add_light(parser)
    parser.add_argument("-o", "--output", required=True, help=".png, .npy, a clip .mp4 or .webm, or a folder/ of PNG")
    parser.add_argument("--alpha", action="store_true", help="PNG with (straight) alpha, without the background")
    parser.add_argument(
        "--depth",
        metavar="FILE",
        help="also write depth: .npy in metres, .png in millimetres (16 bit); 0: empty",
    )
    parser.add_argument("--cameras", metavar="FILE", help="camera file: one object, or a list for several views")
    parser.add_argument("--size", type=size, default=(1024, 1024), help="WxH in pixels (default 1024x1024)")
    parser.add_argument("--fov", type=degrees, default=PAPER_FOV, help="vertical field of view in degrees (default 65)")
    parser.add_argument("--eye", type=point, metavar="X,Y,Z", help="position of the camera (default: all in view)")
    parser.add_argument("--target", type=point, metavar="X,Y,Z", help="point it looks at (default: the scene's centre)")
    parser.add_argument("--stereo", action="store_true", help="both eyes in one pass, side by side in pictures")
    parser.add_argument("--ipd", type=not_negative, default=PAPER_IPD, help="metres between the eyes (default 0.055)")
    parser.add_argument("--background", type=colour, metavar="R,G,B", help="0 to 1 each (default 0,0,0)")
    parser.add_argument("--pose", metavar="FILE", help="pose file (JSON)")
    parser.add_argument(
        "--motion",
        metavar="FILE",
        help=f"{KINDS}, or an embedded motion's name; FILE#NAME selects one of several; "
        "FILE#up=z and the like correct its reading (docs/rigs.md)",
    )
    parser.add_argument(
        "--expression",
        type=expression,
        metavar="NAME=W,...",
        help="weights of the avatar's shapes: jawOpen=0.7,eyeBlinkLeft=1; they override those of a pose or motion",
    )
    parser.add_argument(
        "--speech",
        metavar="FILE",
        help="animate the mouth to a .wav, in a clip of its length; .mp4 has the sound, a motion repeats",
    )
    parser.add_argument(
        "--frame", type=int, metavar="N", help="frame of the motion, or picture of a scene file's clip (default: all)"
    )
    parser.add_argument("--turntable", type=int, metavar="N", help="N views around the scene, as a clip or pictures")
    parser.add_argument("--fps", type=positive, default=30.0, help="frames per second of a clip (default 30)")
    parser.add_argument("--sh-degree", type=int, choices=range(4), default=3, help="evaluate at most this degree")
    parser.add_argument(
        "--antialias",
        action=argparse.BooleanOptionalAction,
        help="opacity compensation for small splats (default: as the file says)",
    )
    add_detail(parser, lean=False)
    parser.add_argument("--rotation", choices=("polar", "raw"), default="polar", help="blended rotation of a skin")
    parser.add_argument(
        "--layers", choices=("auto", "vertex", "geometry"), default="auto", help="shader that writes gl_Layer"
    )
    add_driver(parser)
    parser.add_argument("--json", action="store_true", help="print driver, variant, counts and stage times")


def run(args: argparse.Namespace) -> int:
    """Render by the options."""
    _check_combinations(args)
    output = Path(args.output)
    exact = output.suffix.lower() == ".npy"
    scene = open_scene(args)
    plays = bool(scene.motions) and args.frame is None and not args.motion and not args.pose and _is_sequence(output)
    sequence = args.turntable is not None or (args.motion is not None and args.frame is None) or plays
    sequence = sequence or args.speech is not None
    sound: Sound | None = None
    if args.speech is not None:
        if (speech := plugin("speech.sound")) is None:
            raise GlsplatError(missing("speech", "--speech"))
        sound = speech.read_wav(args.speech)
    count, shots = _shots(args, scene, plays, sound)
    _check_output(args, sequence)  # after the motion: a missing motion is the more likely mistake
    first = next(shots)
    config = RenderConfig(
        target=args.float_target,
        output="float32" if exact or args.alpha else "uint8",  # float, as dividing bytes by a small alpha is inexact
        sorter=args.sorter,
        sh_degree=args.sh_degree,
        antialias=args.antialias,
        debug=DebugConfig(layers=args.layers, rotation=args.rotation),
        **detail_of(args),
    )
    context = create_context(args.device)
    try:
        camera = first.cameras[0]
        with Renderer(
            scene.scene, size=(camera.width, camera.height), views=len(first.cameras), config=config, context=context
        ) as renderer:
            picture = joined_views if args.alpha else side_by_side
            if sequence:

                def rendered() -> Iterator[NDArray[Any]]:
                    for shot in chain([first], shots):
                        scene.pose_at(shot.seconds)
                        yield picture(renderer.render(shot.cameras, shot.pose))

                _save_sequence(args, rendered(), count, sound)
            else:
                scene.pose_at(first.seconds)
                if args.depth:
                    images, depths = renderer.render(first.cameras, first.pose, depth=True)
                    save_depth(args.depth, depths, first.several)
                else:
                    images = renderer.render(first.cameras, first.pose)
                if exact:
                    save_npy(output, images if first.several else images[0])
                else:
                    save_png(output, picture(images))
            if args.json:
                made = {"backend": context.backend, "variant": asdict(renderer.variant), "gpu_bytes": renderer.nbytes()}
                print(json.dumps(made | frame_report(renderer)))
    finally:
        context.release()
    return 0


@dataclass(frozen=True)
class _Shot:
    cameras: list[Camera]
    pose: Pose | None
    several: bool  # a list of views: .npy is [V, H, W, 4]
    seconds: float = 0.0  # on the clock of the scene file's motions


def _check_combinations(args: argparse.Namespace) -> None:
    """Raise UsageError for options that contradict each other."""
    for one, other in (("pose", "motion"), ("cameras", "turntable"), ("cameras", "eye"), ("cameras", "target")):
        if getattr(args, one) is not None and getattr(args, other) is not None:
            raise UsageError(f"give --{one} or --{other}, not both")
    if args.cameras is not None and args.stereo:
        raise UsageError("give --cameras or --stereo, not both; a pair is a list of two cameras")
    ending = Path(args.output).suffix.lower()
    if args.alpha and args.background is not None:
        raise UsageError("give --alpha or --background, not both; with --alpha nothing lies behind the scene")
    if args.alpha and ending == ".npy":
        raise UsageError("--alpha is for PNG; an .npy holds alpha anyway")
    if args.alpha and ending in CLIPS:
        raise UsageError("--alpha is for PNG; a clip has no alpha, give a folder/ of pictures")
    if args.speech is not None and (args.turntable is not None or args.frame is not None):
        raise UsageError(f"give --speech or --{'frame' if args.turntable is None else 'turntable'}, not both")
    if args.turntable is not None and args.motion is not None and args.frame is None:
        raise UsageError("--turntable with --motion needs --frame: the pose to turn around")


def _is_sequence(output: Path) -> bool:
    return output.suffix.lower() not in (".png", ".npy")


def _check_output(args: argparse.Namespace, sequence: bool) -> None:
    """Raise UsageError or FormatError, before the work starts, for an output that cannot be written."""
    if args.depth is not None:
        if sequence:
            raise UsageError("--depth is for one picture, not for a clip or a sequence")
        output_kind("--depth", args.depth, (".npy", ".png"), ".npy (metres) or .png (millimetres)")
        if Path(args.depth).resolve() == Path(args.output).resolve():
            raise UsageError("--depth and -o name the same file")
    if sequence:
        why = "the scene's motions" if args.motion is None else f"--motion {args.motion}"
        why = why if args.turntable is None else f"--turntable {args.turntable}"
        why = why if args.speech is None else f"--speech {args.speech}"
        what = f"a clip .mp4 or .webm for {why}"
        if args.turntable is None and args.speech is None and not _is_sequence(Path(args.output)):
            what += " (for one picture of it add --frame N)"
        output_kind("-o", args.output, tuple(CLIPS), what, folder="PNG files")
        return
    what = ".png or .npy"
    if Path(args.output).suffix.lower() in CLIPS or args.output.endswith("/"):
        what += " (for a clip or a folder/ of pictures give --motion without --frame, or --turntable)"
    output_kind("-o", args.output, (".png", ".npy"), what)


def _shots(args: argparse.Namespace, scene: SceneFile, plays: bool, sound: Sound | None) -> tuple[int, Iterator[_Shot]]:
    """Return the number of pictures, and their cameras and poses; ``plays`` runs the scene file's motions."""
    face = _face(args, scene)
    if args.frame is not None and args.motion is None and not scene.motions:
        raise UsageError("--frame needs --motion, or a scene file with motions")
    pose: Pose | None = None
    motion: Motion | None = None
    seconds = 0.0
    if args.pose:
        pose = load_pose(args.pose, driven(scene, "--pose").skeleton)
    if args.motion:
        motion = motion_of(args.motion, driven(scene, "--motion").skeleton)
    count = max(1, round(scene.duration * args.fps)) if motion is None else len(motion)
    if args.frame is not None:
        if not 0 <= args.frame < count:
            raise UsageError(f"--frame needs 0 to {count - 1} for {args.motion or 'this scene'}, not {args.frame}")
        seconds = args.frame / (args.fps if motion is None else motion.fps)
        pose = pose if motion is None else motion.pose(args.frame)
    pose = face(pose)
    if args.turntable is not None:
        if args.turntable < 1:
            raise UsageError(f"--turntable needs at least 1 view, not {args.turntable}")
        angles = (2 * np.pi * i / args.turntable for i in range(args.turntable))
        return args.turntable, (_Shot(_view(args, scene, angle), pose, False, seconds) for angle in angles)
    cameras, several = read_cameras(args.cameras) if args.cameras else (_view(args, scene), args.stereo)
    if args.alpha:
        cameras = [replace(camera, background=(0.0, 0.0, 0.0)) for camera in cameras]
    if sound is not None:
        from glsplat.extras.speech.speaking import Speaking

        speaking, face = Speaking(sound), _face(args, scene, "--speech")
        count = max(1, round(sound.seconds * args.fps))
        moments = (i / args.fps for i in range(count))
        return count, (
            _Shot(cameras, face(pose if motion is None else motion.at(t), speaking.at(t)), several, t) for t in moments
        )
    if plays or (motion is not None and args.frame is None):
        # by time, so that the clip plays at the motion's speed
        count = max(1, round((scene.duration if motion is None else motion.duration) * args.fps))
        times = (i / args.fps for i in range(count))
        return count, (_Shot(cameras, pose if motion is None else face(motion.at(t)), several, t) for t in times)
    return 1, iter([_Shot(cameras, pose, several, seconds)])


def _face(args: argparse.Namespace, scene: SceneFile, option: str = "--expression") -> Callable[..., Pose | None]:
    """Return ``f(pose, spoken={})``, the pose with the weights of speech and of --expression. Raises UsageError."""
    given = args.expression or {}
    if args.expression is None and option == "--expression":
        return lambda pose: pose
    if scene.motions:
        raise UsageError(f"{option} is for an avatar, not for the motions of a scene file; write it into the poses")
    avatar = driven(scene, option)
    shapes = avatar.shapes if isinstance(avatar, Avatar) else None
    if shapes is None:
        raise UsageError(f"{option} needs an avatar with shapes, this one has none (docs/avatars.md)")
    if unknown := [name for name in given if name not in shapes.names]:
        some = ", ".join([*shapes.names[:6], "..."] if len(shapes) > 6 else shapes.names)
        raise UsageError(f"this avatar has no shape {unknown[0][:40]!r}; it has {some}")
    item = scene.avatar

    def with_face(pose: Pose | None, spoken: Mapping[str, float] = {}) -> Pose:
        held = pose or (item.pose if item is not None else None) or Pose.zero(len(avatar.skeleton))
        return replace(held, expression={**held.expression, **spoken, **given})

    return with_face


def _view(args: argparse.Namespace, scene: SceneFile, angle: float = 0.0) -> list[Camera]:
    eye, target = viewing_point(scene.scene, args.fov)
    eye = eye if args.eye is None else np.array(args.eye)
    target = target if args.target is None else np.array(args.target)
    behind = (0.0, 0.0, 0.0) if args.alpha else args.background or scene.background
    ipd = args.ipd if args.stereo else None
    return view_of(orbited(eye, target, angle), target, args.size, args.fov, ipd, behind)


def _save_sequence(args: argparse.Namespace, pictures: Iterator[NDArray[Any]], count: int, sound: Sound | None) -> None:
    frames = each(pictures, "frames", total=count, quiet=args.json)
    path = Path(args.output)
    if path.suffix.lower() in CLIPS:
        with Clip(path, args.fps, sound) as clip:
            for picture in frames:
                clip.add(picture)
        if not args.json:
            print(clip.summary)
        return
    make_folder(path)
    for number, picture in enumerate(frames):
        save_png(path / f"{number:05d}.png", picture)
