"""Small pairs of pictures, and where PyPI's own ``lpips`` says what it thinks of them: lpips.json beside the pictures.

The pictures p01 and p02 are of synthetic people made of MakeHuman system assets (CC0 since 2020-09). The script
``lpips_reference`` of e1884627 wrote lpips.json with the packages lpips and torch.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["DATA", "small_pairs"]

DATA = Path(__file__).parent / "data"
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
