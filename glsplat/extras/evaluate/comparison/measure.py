"""Measures of every picture: the paper's over the whole square, over the figure's box, and by body part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.extras.evaluate.comparison.protocol import CONTROLS, EXTRA_MEASURES, Protocol
from glsplat.extras.evaluate.comparison.stage import PARTS, StageTruth
from glsplat.extras.evaluate.lpips import Lpips
from glsplat.extras.evaluate.metrics import WHOLE, decibel, flip, inner_mean, ssim_map

MEASURES = ("l1", "lpips", "psnr", "ssim")  # the paper's measures, over the whole square
BOXED = ("box_l1", "box_psnr", "box_ssim")
"""Measures over the box around the participant, which leave out most of the black background."""
PARTED = ("l1", "psnr", "ssim")  # measures by body part, over the pixels nearest to it
OVERLAP = "overlap"  # of the silhouettes: the smaller coverage over the larger, summed over the picture

_BESIDE = 2  # pixels around the figure in its box, for blur
_FEWEST = 30  # pixels of a part that is measured

_network = cache(Lpips)  # reads the weights once


@dataclass(frozen=True, eq=False)
class Reference:
    """The truth with values that are computed once for all avatars."""

    truth: StageTruth
    rgb: NDArray[np.float32]  # [2, H, W, 3] in [0, 1]
    boxes: tuple[tuple[slice, slice], ...]
    features: tuple[Mapping[str, Any], ...]  # of each eye, by network

    @classmethod
    def of(cls, truth: StageTruth, protocol: Protocol) -> Reference:
        """Return the reference of a truth."""
        rgb, networks = _rgb(truth.pictures), _networks(protocol.extra_measures)
        features = tuple({name: network.features(one) for name, network in networks.items()} for one in rgb)
        return cls(truth, rgb, tuple(_box(one) for one in truth.pictures), features)


class Scores:
    """The measures of one avatar, filled picture by picture."""

    def __init__(self, protocol: Protocol, moments: int) -> None:
        self._extra = tuple(name for name in EXTRA_MEASURES if name in protocol.extra_measures)
        shape = (moments, len(protocol.views), 2)
        names = (*MEASURES, *BOXED, OVERLAP, *self._extra)
        self._networks = _networks(protocol.extra_measures)
        self._values = {control: {name: np.full(shape, np.nan) for name in names} for control in CONTROLS}
        self._parts = {
            control: {part: {name: np.full(shape, np.nan) for name in PARTED} for part in PARTS} for control in CONTROLS
        }

    def add(self, control: str, moment: int, view: int, reference: Reference, pictures: NDArray[np.uint8]) -> None:
        """Measure both eyes' pictures [2, H, W, 4] of the avatar."""
        values, parts = self._values[control], self._parts[control]
        for eye, (picture, wanted) in enumerate(zip(_rgb(pictures), reference.rgb, strict=True)):
            at = moment, view, eye
            apart = picture.astype(np.float64) - wanted
            local = ssim_map(picture, wanted)
            places: dict[str, Any] = {"": WHOLE, "box_": reference.boxes[eye]}
            for prefix, box in places.items():
                found = _three(apart[box], inner_mean(local, box))
                for name in PARTED:
                    values[prefix + name][at] = found[name]
            for name, network in self._networks.items():
                values[name][at] = network.distance(network.features(picture), reference.features[eye][name])
            if "flip" in self._extra:
                values["flip"][at] = flip(picture, wanted)
            covered = np.stack([pictures[eye, ..., 3], reference.truth.pictures[eye, ..., 3]]).astype(np.float64)
            values[OVERLAP][at] = covered.min(axis=0).sum() / max(covered.max(axis=0).sum(), 1.0)
            for index, part in enumerate(PARTS):
                mine = reference.truth.regions[eye] == index
                if mine.sum() >= _FEWEST:
                    found = _three(apart[mine], float(local[mine].mean()))
                    for name in PARTED:
                        parts[part][name][at] = found[name]

    def to_json(self, digits: int) -> dict[str, Any]:
        """Return values and parts, rounded to ``digits``; null where a part is not visible."""
        return {"values": _listed(self._values, digits), "parts": _listed(self._parts, digits)}


def _networks(extra_measures: tuple[str, ...]) -> dict[str, Lpips]:
    """Return the network of each LPIPS measure, by the measure's name."""
    return {"lpips": _network("alex")} | ({"lpips-vgg": _network("vgg")} if "lpips-vgg" in extra_measures else {})


def _three(apart: F64, similar: float) -> dict[str, float]:
    """Return the measures of PARTED from differences [..., 3] and mean SSIM."""
    return {"l1": float(np.abs(apart).mean()), "psnr": decibel(float((apart**2).mean())), "ssim": similar}


def _rgb(pictures: NDArray[np.uint8]) -> NDArray[np.float32]:
    return np.asarray(pictures[..., :3] / np.float32(255), np.float32)


def _box(picture: NDArray[np.uint8]) -> tuple[slice, slice]:
    """Return rows and columns of the figure in a picture [H, W, 4]; all of them without a figure."""
    rows, columns = (np.flatnonzero((picture[..., 3] > 0).any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return WHOLE
    return (
        slice(max(0, int(rows[0]) - _BESIDE), int(rows[-1]) + 1 + _BESIDE),
        slice(max(0, int(columns[0]) - _BESIDE), int(columns[-1]) + 1 + _BESIDE),
    )


def _listed(values: Any, digits: int) -> Any:
    """Return arrays in nested dictionaries as nested lists of rounded numbers; None for NaN."""
    if isinstance(values, dict):
        return {key: _listed(value, digits) for key, value in values.items()}
    if isinstance(values, np.ndarray):
        return [_listed(value, digits) for value in values]
    return None if values != values else round(float(values), digits)
