"""Bytes, quality and time of video beside JPEG, of pairs that move: the table behind extras/far_links/video.py.

    python -m tools.net.codec_table [--set-aside]      # some minutes; docs/measured/codec.md holds it

Each setting codes the same pairs in the same order, as the server does, and PyAV decodes them; LPIPS (AlexNet) and PSNR
in the box that the left eye's avatar covers, against the uncompressed picture. The first picture, a key frame, is
counted apart.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import exp, log
from time import perf_counter

import av
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from apps.replay.streaming import observer
from glsplat.data import default_avatar
from glsplat.extras.evaluate.metrics.lpips import Lpips
from glsplat.extras.evaluate.metrics.pixels import psnr
from glsplat.extras.far_links.video import CODECS, STEPS, VideoStream
from glsplat.formats.motion_files import load_embedded_motion
from glsplat.net.codec.encode import Encoder, covered_box
from glsplat.net.codec.encoded import Box
from glsplat.renderer import Renderer

__all__ = ["DEVELOPED", "SET_ASIDE", "Setting", "markdown", "rows", "sequence"]

SIDE, RATE, COUNT = 1024, 20, 48  # pixels, pairs a second, pairs
EVERY = 6  # pairs, of which one is looked at
DEVELOPED = "wave-and-turn"  # the demo's motion: qualities were chosen by it
SET_ASIDE = "walk"
FACTORS = {"vp9": (16, 24, 32, 38, 45, 52), "h264": (17, 22, 27, 30, 34, 38)}
QUALITIES = (90, 80, 60, 40, 20)

Image = NDArray[np.uint8]
Pair = tuple[Image, Box]  # [2, H, W, 4] and what of it is covered


@dataclass(frozen=True, slots=True)
class Setting:
    """Means over a sequence, but for the first picture."""

    codec: str
    quality: str  # JPEG's, or the codec's factor
    nbytes: float  # a pair
    first: int  # bytes of the first
    lpips: float
    psnr: float
    encode: float  # ms, median
    late: float  # ms, 95th percentile
    decode: float  # ms, median


def sequence(motion: str) -> list[Pair]:
    """Pairs of the default avatar as ``glsplat replay`` sees it."""
    avatar = default_avatar()
    moves = load_embedded_motion(motion, avatar.skeleton)
    out = []
    with Renderer(avatar) as renderer:
        renderer.resize(SIDE, SIDE)
        for index in range(COUNT):
            pose = moves.at(index / RATE)
            images = renderer.render(observer(index / RATE, pose.trans, (SIDE, SIDE)), pose).copy()
            out.append((images, covered_box(np.maximum(*images))))
    return out


class Judge:
    """LPIPS and PSNR of left eyes against the truth."""

    def __init__(self, pairs: Sequence[Pair]) -> None:
        self._lpips = Lpips("alex")
        self._truth = {}
        for index in range(EVERY - 1, len(pairs), EVERY):
            x, y, w, h = covered_box(pairs[index][0][0])
            part = np.s_[y : y + h, x : x + w]
            truth = pairs[index][0][0][..., :3][part]
            self._truth[index] = part, truth, self._lpips.features(truth / 255)

    def __call__(self, index: int, seen: Callable[[], Image]) -> list[tuple[float, float]]:
        if index not in self._truth:
            return []
        part, truth, features = self._truth[index]
        found = seen()[part]
        return [(self._lpips.distance(self._lpips.features(found / 255), features), psnr(found / 255, truth / 255))]


def jpegs(pairs: Sequence[Pair], judge: Judge) -> Iterator[Setting]:
    """As they are sent, whole and cropped."""
    encoder = Encoder()
    for crop in (False, True):
        for quality in QUALITIES:
            sizes, times, decoded, seen = [], [], [], []
            for index, (images, box) in enumerate(pairs):
                made = encoder.encode(images, quality, crop, box)
                sizes.append(sum(map(len, made.pictures)))
                times.append(made.ms)
                start = perf_counter()
                left = simplejpeg.decode_jpeg(made.pictures[0], "RGB")
                simplejpeg.decode_jpeg(made.pictures[1], "RGB")
                decoded.append((perf_counter() - start) * 1e3)
                if not crop:
                    seen += judge(index, lambda left=left: left)  # type: ignore[misc]
            lpips, psnr = np.mean(seen, axis=0) if seen else (np.nan, np.nan)
            name = "JPEG, cropped" if crop else "JPEG"
            yield Setting(name, str(quality), *_means(sizes), lpips, psnr, *_times(times, decoded))
    encoder.close()


def videos(pairs: Sequence[Pair], judge: Judge) -> Iterator[Setting]:
    """Each codec at several factors."""
    for codec, factors in FACTORS.items():
        for factor in factors:
            coder = replace(CODECS[codec], factors=(factor,) * len(STEPS))
            stream, decoder = VideoStream(coders={codec: coder}), av.CodecContext.create(codec, "r")
            decoder.options = {"flags": "low_delay"}
            sizes, times, decoded, seen = [], [], [], []
            for index, (images, box) in enumerate(pairs):
                made = stream.encode(images, [codec], 80, box)
                assert made is not None
                sizes.append(len(made.pictures[0]))
                times.append(made.ms)
                start = perf_counter()
                (frame,) = decoder.decode(av.Packet(made.pictures[0]))  # type: ignore[attr-defined]
                decoded.append((perf_counter() - start) * 1e3)
                seen += judge(index, lambda frame=frame: frame.to_ndarray(format="rgb24")[:, :SIDE])  # type: ignore[misc]
            lpips, psnr = np.mean(seen, axis=0)
            yield Setting(codec, str(factor), *_means(sizes), lpips, psnr, *_times(times, decoded))


def _means(sizes: Sequence[int]) -> tuple[float, int]:
    return float(np.mean(sizes[1:])), sizes[0]


def _times(times: Sequence[float], decoded: Sequence[float]) -> tuple[float, float, float]:
    return float(np.median(times[1:])), float(np.percentile(times[1:], 95)), float(np.median(decoded[1:]))


def rows(motion: str) -> list[Setting]:
    """Every setting."""
    pairs = sequence(motion)
    judge = Judge(pairs)
    found = [*jpegs(pairs, judge), *videos(pairs, judge)]
    sight = {one.quality: (one.lpips, one.psnr) for one in found if one.codec == "JPEG"}
    whole = [replace(one, lpips=sight[one.quality][0], psnr=sight[one.quality][1]) for one in found if "," in one.codec]
    return [one for one in found if one.codec == "JPEG"] + whole + [one for one in found if one.codec in CODECS]


def at_equal_sight(found: Sequence[Setting], codec: str, lpips: float) -> float:
    """Bytes a pair of that codec at that LPIPS, between its settings (logarithmically); nan outside of them."""
    own = sorted((one.lpips, one.nbytes) for one in found if one.codec == codec)
    for (low, more), (high, fewer) in pairwise(own):
        if low <= lpips <= high:
            part = (log(lpips) - log(low)) / (log(high) - log(low))
            return exp(log(more) + part * (log(fewer) - log(more)))
    return float("nan")


def markdown(motion: str) -> str:
    """Both tables, one behind the other."""
    found = rows(motion)
    lines = [
        "| codec | quality or factor | kB a pair | first, kB | LPIPS | PSNR, dB | encoding, ms | 95 % | decoding, ms |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for one in found:
        lines.append(
            f"| {one.codec} | {one.quality} | {one.nbytes / 1e3:.1f} | {one.first / 1e3:.1f} | {one.lpips:.4f} "
            f"| {one.psnr:.1f} | {one.encode:.1f} | {one.late:.1f} | {one.decode:.1f} |"
        )
    lines += ["", "| as good as JPEG of quality | JPEG, cropped | vp9 | h264 |", "|--:|--:|--:|--:|"]
    for one in found:
        if one.codec == "JPEG, cropped":
            parts = [at_equal_sight(found, codec, one.lpips) / one.nbytes for codec in CODECS]
            cells = " | ".join("-" if np.isnan(part) else f"{part:.2f}" for part in parts)
            lines.append(f"| {one.quality} | 1 | {cells} |")
    return "\n".join(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--set-aside", action="store_true", help="the motion that qualities were not chosen by")
    print(markdown(SET_ASIDE if parser.parse_args().set_aside else DEVELOPED))
