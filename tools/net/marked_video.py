"""What video leaves of a watermark: windows of 30 pictures that the detector finds (docs/watermark.md).

    python -m tools.net.marked_video [--people anna mei] [--windows 4]      # some minutes

Each window is drawn with a payload of its own, seen whole, 512 x 512 an eye, and coded as a server codes it for as good
as each JPEG quality (codec/video.py); the left eye is then searched. JPEG itself stands beside it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
import simplejpeg
from numpy.typing import NDArray

from apps.replay.streaming import observer
from glsplat.data import PEOPLE, person
from glsplat.extras.far_links.video import CODECS, STEPS, VideoStream
from glsplat.extras.far_links.video_reader import VideoReader
from glsplat.extras.watermark import Watermark
from glsplat.extras.watermark.detect import detect
from glsplat.formats.motion_files import load_embedded_motion
from glsplat.net.codec.encode import encode_picture
from glsplat.renderer import Renderer

__all__ = ["markdown"]

SIDE, RATE, WINDOW = 512, 20, 30  # pixels, pictures a second, pictures
MOTIONS = ("wave-and-turn", "walk")
KEY = b"a key of the measurement"

Images = list[NDArray[np.uint8]]  # [2, H, W, 4] each


def windows(people: list[str], count: int) -> Iterator[tuple[int, Images]]:
    """Payloads and what bears them."""
    session = 1
    for name in people:
        avatar = person(name)
        with Renderer(avatar, size=(SIDE, SIDE), views=2) as renderer:
            for motion in MOTIONS:
                moves = load_embedded_motion(motion, avatar.skeleton)
                for window in range(count):
                    renderer.step = Watermark(server=7, session=session, key=KEY)
                    times = (window * WINDOW / RATE + i / RATE for i in range(WINDOW))
                    poses = [(t, moves.at(t)) for t in times]
                    yield (
                        session,
                        [renderer.render(observer(t, pose.trans, (SIDE, SIDE)), pose).copy() for t, pose in poses],
                    )
                    session += 1


def seen(images: Images, codec: str, quality: int) -> Images:
    """The left eye's pictures [H, W, 3] as a client has them."""
    if codec == "JPEG":
        coded = (encode_picture(pair[0], quality) for pair in images)
        return [simplejpeg.decode_jpeg(one, "RGB") for one in coded]
    stream, reader, out = VideoStream(), VideoReader(), []
    for pair in images:
        made = stream.encode(pair, [codec], quality)
        assert made is not None and made.video is not None
        out.append(reader.eyes(made.pictures[0], made.video, (SIDE, SIDE))[0])
    return out


def markdown(people: list[str], count: int) -> Iterator[str]:
    """The table, line by line."""
    found: dict[tuple[str, int], list[int]] = {}
    for session, images in windows(people, count):
        for codec in ("JPEG", *CODECS):
            for quality in STEPS:
                mark = detect(seen(images, codec, quality), KEY)
                hit = found.setdefault((codec, quality), [0, 0, 0])
                hit[0] += mark is not None and mark.session == session
                hit[1] += mark is not None and mark.session != session
                hit[2] += 1
    yield f"| as good as JPEG of | {' | '.join(map(str, STEPS))} |"
    yield "|---|" + "--:|" * len(STEPS)
    for codec in ("JPEG", *CODECS):
        cells = [found[codec, quality] for quality in STEPS]
        yield f"| {codec} | " + " | ".join(f"{right} of {of}" for right, _, of in cells) + " |"
    yield f"\nWrong ids: {sum(wrong for _, wrong, _ in found.values())}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--people", nargs="+", default=list(PEOPLE), choices=PEOPLE)
    parser.add_argument("--windows", type=int, default=3, help="of each person in each motion")
    args = parser.parse_args()
    for line in markdown(args.people, args.windows):
        print(line, flush=True)
