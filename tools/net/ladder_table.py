"""Measure bytes and visible loss of JPEG qualities and sizes: the table behind glsplat/net/pace/ladder.py, in minutes.

Each setting is drawn, encoded as by the server, decoded, enlarged to full size as a texture, and compared with the
uncompressed picture of full size: LPIPS (AlexNet) and PSNR in the box that the avatar covers. Bytes are of that box, as
with ``crop``, and of the whole picture.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from apps.args import load_avatar
from apps.replay.streaming import observer
from glsplat.avatar import Avatar
from glsplat.data import PEOPLE
from glsplat.extras.evaluate.difference import pareto
from glsplat.extras.evaluate.lpips import Lpips
from glsplat.formats.motion_files import load_embedded_motion
from glsplat.net.codec.encode import covered_box, encode_picture
from glsplat.net.pace.ladder import SCALES
from glsplat.renderer import Renderer

SIDE = 1024  # side of a whole picture in pixels
QUALITIES = (95, 90, 80, 70, 60, 50, 40, 30, 20, 10)
DEVELOPED = (("wave-and-turn", 1.0), ("walk", 0.4))  # motion and second from which the ladder was derived
SET_ASIDE = (("wave-and-turn", 3.3), ("idle", 2.0))  # held-out moments

Moments = Sequence[tuple[str, float]]
Image = NDArray[np.uint8]


def _pictures(avatar: Avatar, moments: Moments) -> Iterator[dict[float, Image]]:
    """Yield the uncompressed left eye of each moment, by scale."""
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


def table(files: Sequence[str], moments: Moments) -> str:
    """Return the Pareto front in bytes and LPIPS as a table, most bytes first, over embedded people and ``files``."""
    lpips = Lpips("alex")
    found: dict[tuple[float, int], list[tuple[float, ...]]] = {}
    for name in (*PEOPLE, *files):
        avatar = load_avatar(name, "AVATAR")
        assert isinstance(avatar, Avatar)
        for drawn in _pictures(avatar, moments):
            x, y, w, h = covered_box(drawn[1.0])
            truth = drawn[1.0][y : y + h, x : x + w, :3]
            features = lpips.features(truth / 255)
            for scale, image in drawn.items():
                bx, by, bw, bh = covered_box(image)
                for quality in QUALITIES:
                    jpeg = encode_picture(image, quality)
                    box = encode_picture(image[by : by + bh, bx : bx + bw], quality)
                    seen: Image = simplejpeg.decode_jpeg(jpeg, "RGB")
                    if scale < 1:
                        seen = np.asarray(cv2.resize(seen, (SIDE, SIDE), interpolation=cv2.INTER_LINEAR), np.uint8)
                    part = seen[y : y + h, x : x + w]
                    distance = lpips.distance(lpips.features(part / 255), features)
                    found.setdefault((scale, quality), []).append(
                        (len(box), len(jpeg), distance, cv2.PSNR(part, truth))
                    )
    costs = [(*key, *np.mean(values, axis=0).tolist()) for key, values in found.items()]
    front = pareto([(nbytes, -loss) for _, _, nbytes, _, loss, _ in costs])
    rows = ["| size | quality | kB an eye, box | whole | LPIPS | PSNR, dB |", "|" + "--:|" * 6]
    for scale, quality, nbytes, whole, loss, psnr in (costs[i] for i in reversed(front)):
        rows.append(f"| {scale:g} | {quality} | {nbytes / 1e3:.1f} | {whole / 1e3:.1f} | {loss:.4f} | {psnr:.1f} |")
    return "\n".join(rows)
