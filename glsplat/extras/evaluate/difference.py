"""The difference of a picture from the float64 reference, and Pareto fronts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat import reference
from glsplat.avatar import Avatar, splats_of
from glsplat.camera import Camera
from glsplat.errors import GlsplatError
from glsplat.extras.evaluate.metrics import decibel
from glsplat.extras.evaluate.metrics import flip as mean_flip
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats

PSNR_CAP = 160.0  # decibels reported for equal pictures: JSON has no infinity


@dataclass(frozen=True)
class Difference:
    """Differences of pictures [V, H, W, 4] from a reference; clipped to [0, 1] only for FLIP."""

    psnr: float  # dB over RGB, for a peak of 1
    mean: float  # absolute, over RGB and alpha
    maximum: float  # absolute, over RGB and alpha
    beyond: float  # share of pixels with a channel off by more than 1/255
    flip: float | None  # mean over the first view; None: not computed

    @classmethod
    def of(cls, image: NDArray[Any], expected: NDArray[np.float64], flip: bool = True) -> Difference:
        """Return the difference; non-finite values count as an error of 1e3. Raises GlsplatError for unequal shapes."""
        if image.shape != expected.shape:
            raise GlsplatError(f"pictures to compare need one shape, not {image.shape} and {expected.shape}")
        scaled = image / 255.0 if image.dtype == np.uint8 else image.astype(np.float64)
        error = np.nan_to_num(np.abs(scaled - expected), nan=1e3, posinf=1e3)
        mse = float((error[..., :3] ** 2).mean())
        return cls(
            psnr=round(decibel(mse, most=PSNR_CAP), 3),
            mean=float(error.mean()),
            maximum=float(error.max()),
            beyond=float((error.max(axis=-1) > 1 / 255).mean()),
            flip=round(mean_flip(_shown(scaled), _shown(expected)), 6) if flip else None,
        )

    @classmethod
    def worst(cls, several: Sequence[Difference]) -> Difference:
        """Return the worst value of each measure over several frames."""
        flips = [d.flip for d in several if d.flip is not None]
        return cls(
            psnr=min(d.psnr for d in several),
            mean=max(d.mean for d in several),
            maximum=max(d.maximum for d in several),
            beyond=max(d.beyond for d in several),
            flip=max(flips) if flips else None,
        )

    @property
    def contract(self) -> bool:
        """Whether the picture is within the gate of a 32F target (docs/conventions.md)."""
        return self.psnr >= 65 and self.mean <= 1e-4 and self.beyond <= 0.003 and self.maximum <= 0.06


def reference_pictures(scene: Splats | Avatar, views: Sequence[Camera], pose: Pose | None) -> NDArray[np.float64]:
    """Return pictures [V, H, W, 4] in float64 under the pixel contract, with all influences."""
    if not isinstance(scene, Avatar):
        return reference.render(splats_of(scene), views)
    bones = (pose or Pose.zero(len(scene.skeleton))).bones(scene.skeleton)
    return reference.render(scene.splats, views, scene.skin, bones)


def pareto(points: Sequence[tuple[float, float]]) -> list[int]:
    """Return the indices of the (cost, quality) points on the Pareto front, in the order of cost."""
    order = sorted(range(len(points)), key=lambda i: (points[i][0], -points[i][1]))
    front: list[int] = []
    for i in order:
        if not front or points[i][1] > points[front[-1]][1]:
            front.append(i)
    return front


def _shown(views: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the first view's colours, clipped to [0, 1]."""
    return np.clip(np.nan_to_num(views[0, ..., :3]), 0, 1)
