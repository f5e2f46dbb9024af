"""Turns the red irises of MakeHuman's `brown_eye` brown, in a person archive: what the embedded avatar is made of.

python -m tools.data.irises PERSON.npz OUT.npz
"""

from __future__ import annotations

import argparse

import cv2
import numpy as np
from numpy.typing import NDArray

BROWN = 0.4, 0.7, 1.15  # blue, green, red, of what was red


def browned(texture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """[H, W, 4] BGRA. What is red, and neither white nor a vein, keeps its brightness and becomes brown."""
    colour = texture[..., :3].astype(np.float64)
    red, green = colour[..., 2:], colour[..., 1:2]
    share = np.clip((red / np.maximum(green, 1) - 1.6) / 0.4, 0, 1)
    out = texture.copy()
    out[..., :3] = np.clip(np.rint(colour * (1 - share) + red * BROWN * share), 0, 255)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("person")
    parser.add_argument("out")
    options = parser.parse_args()
    data = dict(np.load(options.person))
    for index, name in enumerate(data["part_names"]):
        if "/eyes/" in name:
            texture = np.asarray(cv2.imdecode(data[f"texture_{index}"], cv2.IMREAD_UNCHANGED), np.uint8)
            data[f"texture_{index}"] = cv2.imencode(".png", browned(texture))[1].ravel()
    np.savez_compressed(options.out, **data)


if __name__ == "__main__":
    main()
