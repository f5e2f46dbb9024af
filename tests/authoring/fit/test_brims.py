"""A brim is no hair: it does not pull the head's surface out."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from glsplat.authoring.fit.outline import brimless

FIGURE, NECK = 480.0, 100  # rows; below it nobody asks


def head() -> np.ndarray:
    """[160, 160] a head with a neck and shoulders."""
    mask = np.zeros((160, 160), np.uint8)
    cv2.ellipse(mask, (80, 60), (24, 32), 0, 0, 360, 1, -1)
    cv2.rectangle(mask, (68, 80), (92, 110), 1, -1)
    cv2.ellipse(mask, (80, 140), (70, 36), 0, 0, 360, 1, -1)
    return mask


@pytest.mark.parametrize("thick", [3, 7])
@pytest.mark.parametrize("aslant", [-4, 0, 4])
def test_a_hat_has_no_brim_then(thick: int, aslant: int) -> None:
    plain = head()
    worn = cv2.ellipse(plain.copy(), (80, 42), (52, thick), aslant, 0, 360, 1, -1)
    assert worn.sum() - plain.sum() > 100
    left, plain = brimless(worn > 0, FIGURE)[:NECK], plain[:NECK]
    assert (left & (plain == 0)).sum() < 0.2 * (worn[:NECK].sum() - plain.sum())
    assert (left & (plain > 0)).sum() > 0.98 * plain.sum()


def test_hair_and_ears_stay() -> None:
    mask = head()
    cv2.ellipse(mask, (80, 62), (34, 38), 0, 0, 360, 1, -1)  # a shock of hair
    for x in (46, 114):
        cv2.ellipse(mask, (x, 62), (5, 9), 0, 0, 360, 1, -1)
    lost = (brimless(mask > 0, FIGURE) != (mask > 0))[:NECK]
    assert lost.sum() < 0.02 * mask[:NECK].sum()
