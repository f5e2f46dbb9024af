"""Count the windows in which a mark is found after JPEG, scaling, cropping and x264, or after streaming.

    python -m tools.docs.watermark_rates AVATAR... --motion MOTION... [--windows 10] [--streamed]

Each avatar is drawn with each motion at 512x512, whole, from the waist up and as head and shoulders. Windows of 30
pictures start one picture after the other, each with a payload of its own. The mark is drawn by its twin in Python,
which the tests hold to the shader. ``--streamed`` codes pictures of the whole person as a server does, as JPEG and as
video of the same quality. The results are in docs/watermark.md.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import simplejpeg
from numpy.typing import NDArray

from glsplat.camera import Camera, look_at, pinhole
from glsplat.config import RenderConfig
from glsplat.extras.far_links.video import CODECS, STEPS, VideoStream
from glsplat.extras.far_links.video_reader import VideoReader
from glsplat.extras.watermark.detect import WINDOW, detect
from glsplat.extras.watermark.mark import Watermark, marked
from glsplat.formats import load
from glsplat.formats.motion_files import load_motion
from glsplat.net.codec.encode import encode_picture
from glsplat.renderer import Renderer
from tests.extras.watermark.attacks import ATTACKS, Clip, Head

KEY = b"a key of measurements"
SIDE = 512
VIEWS = {"whole": (0.5, 1.0), "waist up": (0.28, 0.55), "head": (0.14, 0.3)}
"""Middle below the top, and height, as shares of the person's height."""


def streamed(clip: Clip, head: Head, codec: str, quality: int) -> Clip:
    """Return the pictures as a client of the server decodes them."""
    if codec == "JPEG":
        return np.stack([simplejpeg.decode_jpeg(encode_picture(picture, quality), "RGB") for picture in clip])
    stream, reader, out = VideoStream(), VideoReader(), []
    for picture in clip:
        eye = np.dstack([picture, np.full(picture.shape[:2], 255, np.uint8)])
        made = stream.encode(np.stack([eye, eye]), [codec], quality)
        assert made is not None and made.video is not None
        out.append(reader.eyes(made.pictures[0], made.video, (SIDE, SIDE))[0])
    return np.stack(out)


STREAMED: dict[str, Callable[[Clip, Head], Clip]] = {
    f"{codec} {quality}": partial(streamed, codec=codec, quality=quality)
    for codec in ("JPEG", *CODECS)
    for quality in STEPS
}


def drawn(avatar: Path, motion: str, view: str, count: int) -> tuple[NDArray[np.float32], Head]:
    """Return pictures [count, SIDE, SIDE, 4] from frame 40 on, and the middle one's box of head and shoulders."""
    figure = load(avatar)
    moving = load_motion(motion, figure.skeleton).resampled(30)
    poses = [moving.pose(min(40 + i, len(moving) - 1)) for i in range(count)]
    focal = pinhole(SIDE, SIDE)
    with Renderer(figure, size=(SIDE, SIDE), config=RenderConfig(output="float32")) as renderer:
        at = np.mean([pose.trans for pose in poses], axis=0)
        far = Camera(look_at(tuple(at + (0, 0, 6.0)), tuple(at)), focal, SIDE, SIDE)
        ys, xs = np.nonzero(renderer.render([far], poses[count // 2])[0, ..., 3] > 0.5)
        pixel = 6 / focal[1, 1]  # metres
        height, top = np.ptp(ys) * pixel, at[1] + (SIDE / 2 - ys.min()) * pixel
        below, share = VIEWS[view]
        target = np.array([at[0] + (xs.mean() - SIDE / 2) * pixel, top - below * height, at[2]])
        away = share * height * focal[1, 1] / (0.9 * SIDE)
        near = Camera(look_at(tuple(target + (0.25 * away, 0.05 * away, away)), tuple(target)), focal, SIDE, SIDE)
        pictures = np.stack([renderer.render([near], pose)[0] for pose in poses])
    tall = height * focal[1, 1] / away
    first = max(0, int(SIDE / 2 - below * tall - 6))
    columns = slice(max(0, int(SIDE / 2 - 0.15 * tall)), min(SIDE, int(SIDE / 2 + 0.15 * tall)))
    return pictures, (slice(first, min(SIDE, int(first + 0.24 * tall))), columns)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("avatars", nargs="+", type=Path)
    parser.add_argument("--motion", nargs="+", default=["idle", "walk", "wave-and-turn"])
    parser.add_argument("--windows", type=int, default=10, help="of each avatar, motion and view")
    parser.add_argument("--streamed", action="store_true", help="code the pictures as a server does")
    args = parser.parse_args()
    views, attacks = (["whole"], STREAMED) if args.streamed else (list(VIEWS), ATTACKS)
    rng = np.random.default_rng(0)
    found, alarms, windows = Counter[str](), 0, 0
    for avatar, motion, view in ((a, m, v) for a in args.avatars for m in args.motion for v in views):
        pictures, head = drawn(avatar, motion, view, WINDOW + args.windows - 1)
        for start in range(args.windows):
            mark = Watermark(int(rng.integers(1 << 16)), int(rng.integers(1 << 32)), KEY)
            clip = marked(pictures[start : start + WINDOW], mark)[..., :3]
            clip = np.round(np.clip(clip, 0, 1) * 255).astype(np.uint8)
            windows += 1
            for name, attack in attacks.items():
                result = detect(attack(clip, head), KEY)
                right = result is not None and (result.server, result.session) == (mark.server, mark.session)
                found[name] += right
                alarms += result is not None and not right
        print(f"{avatar.name} {motion} {view}: {dict(found)} of {windows}, wrong {alarms}", flush=True)


if __name__ == "__main__":
    main()
