"""What JPEG quality, size and chroma cost in bits and in sight: the table behind glsplat/net/pace/ladder.py.

    python -m tools.net.ladder_table [AVATAR ...]      # three embedded people and those files; some minutes

Each setting is drawn, encoded as the server does, decoded, enlarged to the full size as a texture is, and compared
with the uncompressed picture of the full size: LPIPS (AlexNet) and PSNR in the box that the avatar covers. Bytes are
those of that box, as pictures with ``crop`` have them, and of the whole picture.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from apps.args import load_avatar
from apps.replay.streaming import observer
from glsplat.avatar import Avatar
from glsplat.data import PEOPLE, person
from glsplat.extras.evaluate.metrics.lpips import Lpips
from glsplat.formats.motion_files import load_embedded_motion
from glsplat.net.codec.encode import covered_box, encode_picture
from glsplat.net.pace.ladder import SCALES
from glsplat.renderer import Renderer

SIDE = 1024  # pixels of a whole picture
QUALITIES = (95, 90, 80, 70, 60, 50, 40, 30, 20, 10)
CHROMA = ("444", "420", "411")
DEVELOPED = (("wave-and-turn", 1.0), ("walk", 0.4))  # motion and second: the ladder was drawn from these ...
SET_ASIDE = (("wave-and-turn", 3.3), ("idle", 2.0))  # ... and is looked at on these

Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Cost:
    """Of one setting, over all pictures."""

    scale: float
    quality: int
    chroma: str
    nbytes: float  # of the avatar's box in one eye
    whole: float  # bytes of the whole picture
    lpips: float
    psnr: float


def _people(files: Sequence[Path]) -> Iterator[tuple[str, Avatar]]:
    for name in PEOPLE:
        yield name, person(name)
    for path in files:
        found = load_avatar(path, "AVATAR")
        assert isinstance(found, Avatar)
        yield path.stem, found


def _pictures(avatar: Avatar, moments: Sequence[tuple[str, float]]) -> Iterator[dict[float, Image]]:
    """The left eye of a moment at each of the scales, uncompressed."""
    with Renderer(avatar) as renderer:
        for motion, second in moments:
            pose = load_embedded_motion(motion, avatar.skeleton).at(second)
            eye = observer(second, pose.trans, (SIDE, SIDE))[0]
            drawn = {}
            for scale in SCALES:
                side = round(SIDE * scale)
                renderer.resize(side, side)
                drawn[scale] = renderer.render([eye.resized(side, side)], pose)[0].copy()
            yield drawn


def costs(files: Sequence[Path], moments: Sequence[tuple[str, float]], qualities: Sequence[int]) -> list[Cost]:
    """Every setting of CHROMA, SCALES and ``qualities``; other chroma than the default's only at the full size."""
    lpips = Lpips("alex")
    rows: dict[tuple[float, int, str], list[tuple[float, ...]]] = {}
    for name, avatar in _people(files):
        for drawn in _pictures(avatar, moments):
            x, y, w, h = covered_box(drawn[1.0])
            truth = drawn[1.0][y : y + h, x : x + w, :3]
            features = lpips.features(truth / 255)
            for scale, image in drawn.items():
                for chroma in CHROMA if scale == 1 else ("420",):
                    for quality in qualities:
                        jpeg = encode_picture(image, quality, chroma)
                        bx, by, bw, bh = covered_box(image)
                        box = encode_picture(image[by : by + bh, bx : bx + bw], quality, chroma)
                        seen: Image = simplejpeg.decode_jpeg(jpeg, "RGB")
                        if scale < 1:
                            seen = np.asarray(cv2.resize(seen, (SIDE, SIDE), interpolation=cv2.INTER_LINEAR), np.uint8)
                        part = seen[y : y + h, x : x + w]
                        error = float(np.mean((part.astype(np.float64) - truth) ** 2))
                        found = lpips.distance(lpips.features(part / 255), features)
                        psnr = 10 * np.log10(255**2 / error)
                        rows.setdefault((scale, quality, chroma), []).append((len(box), len(jpeg), found, psnr))
        print(f"<!-- {name} -->", flush=True)
    return [Cost(*key, *np.mean(values, axis=0).tolist()) for key, values in rows.items()]


def front(found: Sequence[Cost]) -> set[Cost]:
    """Those of the default chroma that no other setting beats in both bytes and LPIPS."""
    mine = [one for one in found if one.chroma == "420"]
    return {one for one in mine if not any(o.nbytes <= one.nbytes and o.lpips < one.lpips for o in mine)}


def markdown(found: Sequence[Cost]) -> str:
    """The table, the dearest first."""
    best = front(found)
    rows = [
        "| size | quality | chroma | kB an eye, box | whole | LPIPS | PSNR, dB | on the front |",
        "|--:|--:|--:|--:|--:|--:|--:|---|",
    ]
    for one in sorted(found, key=lambda one: -one.nbytes):
        mark = "yes" if one in best else ""
        chroma = ":".join(one.chroma)
        rows.append(
            f"| {one.scale:g} | {one.quality} | {chroma} | {one.nbytes / 1e3:.1f} | {one.whole / 1e3:.1f} "
            f"| {one.lpips:.4f} | {one.psnr:.1f} | {mark} |"
        )
    return "\n".join(rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("avatars", nargs="*", type=Path)
    parser.add_argument("--set-aside", action="store_true", help="the moments that the ladder was not drawn from")
    arguments = parser.parse_args()
    moments = SET_ASIDE if arguments.set_aside else DEVELOPED
    print(markdown(costs(arguments.avatars, moments, QUALITIES)))
