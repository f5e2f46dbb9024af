"""The metrics against independent implementations on 20 pairs of 512 x 512 pixels, of the people that come along.

    python -m tests.evaluate.scripts.pairs PAIRS.npz                     # write the pairs
    ENV/bin/python -m tests.evaluate.scripts.lpips_reference ALEXNET.ckpt VGG16.ckpt PAIRS.npz > TORCH.json
    python -m tests.evaluate.scripts.pairs PAIRS.npz TORCH.json          # largest differences

ENV is the one of lpips_reference.py; SSIM is scikit-image's, PSNR and L1 are numpy's.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from glsplat.data import participants_folder
from glsplat.evaluate.comparison.participant import participants_in
from glsplat.evaluate.comparison.performance import perform
from glsplat.evaluate.comparison.protocol import Protocol
from glsplat.evaluate.comparison.stage import Stage
from glsplat.evaluate.metrics.lpips import Lpips
from glsplat.evaluate.metrics.pixels import psnr
from glsplat.evaluate.metrics.structure import ssim

F32 = NDArray[np.float32]


def pairs() -> dict[str, tuple[F32, F32]]:
    """Each person against a shifted, a compressed, a blurred, a brighter picture of themselves, and somebody else."""
    protocol = Protocol(tasks=("hands on hips",), views=("front",))
    seen: dict[str, NDArray[np.uint8]] = {}
    for one in participants_in(participants_folder()):
        with Stage(one.mesh, perform(one.mesh, protocol.tasks), protocol) as stage:
            seen[one.name] = stage.truth(0, "front").pictures[0, ..., :3]
    found: dict[str, tuple[F32, F32]] = {}
    for place, (name, truth) in enumerate(seen.items()):
        coded = cv2.imdecode(cv2.imencode(".jpg", truth, [cv2.IMWRITE_JPEG_QUALITY, 60])[1], cv2.IMREAD_COLOR)
        other = list(seen.values())[(place + 1) % len(seen)]
        changed = {
            "shifted": np.roll(truth, 1, axis=1),
            "JPEG": coded,
            "blurred": cv2.GaussianBlur(truth, None, 2.0),
            "gamma": np.rint(255 * (truth / 255) ** (1 / 2.2)).astype(np.uint8),
            "somebody else": other,
        }
        for change, picture in changed.items():
            found[f"{name}, {change}"] = _float(picture), _float(truth)
    return found


def _float(picture: NDArray[np.uint8]) -> F32:
    return np.ascontiguousarray(picture, np.float32) / np.float32(255)


def main() -> None:
    """Write the pairs, or compare."""
    file = Path(sys.argv[1])
    if len(sys.argv) < 3:
        made = pairs()
        np.savez(
            file, **{f"{key}-a": one for key, (one, _) in made.items()}, **{f"{k}-b": b for k, (_, b) in made.items()}
        )
        print(f"{len(made)} pairs")
        return
    torch = json.loads(Path(sys.argv[2]).read_text())
    networks = {kind: Lpips(kind) for kind in ("alex", "vgg")}
    worst: dict[str, float] = dict.fromkeys(("ssim", "psnr", "alex", "vgg"), 0.0)
    with np.load(file) as arrays:
        for key in (name[:-2] for name in arrays if name.endswith("-a")):
            one, truth = arrays[f"{key}-a"], arrays[f"{key}-b"]
            wanted = structural_similarity(
                one, truth, data_range=1, channel_axis=2, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
            )
            worst["ssim"] = max(worst["ssim"], abs(ssim(one, truth) - wanted))
            worst["psnr"] = max(
                worst["psnr"], abs(psnr(one, truth) - peak_signal_noise_ratio(truth, one, data_range=1))
            )
            for kind, network in networks.items():
                found = network.distance(network.features(one), network.features(truth))
                worst[kind] = max(worst[kind], abs(found - torch[kind][key]))
    print(", ".join(f"{name} {value:.2g}" for name, value in worst.items()))


if __name__ == "__main__":
    main()
