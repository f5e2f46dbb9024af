"""What is baked into the textures of the lit room: edges of the sun without teeth, walls without halos."""

from __future__ import annotations

import base64

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.browser.opened import Opened

BAKED = """async () => {
  const { ATLAS, FACES, bake } = await import('/vr/place/bake.js');
  const { LOOKS } = await import('/vr/place/looks.js');
  const { half, windows } = LOOKS.day;
  const data = btoa(bake(LOOKS.day).reduce((text, byte) => text + String.fromCharCode(byte), ''));
  return { data, atlas: [ATLAS.height, ATLAS.width], floor: FACES.floor, wall: FACES.walls[0], half, windows };
}"""


@pytest.fixture
def day(modules: Opened) -> dict[str, NDArray[np.float64]]:
    """Red of floor and of the wall with two windows [H, W]; half of the room; its windows."""
    found = modules.js(BAKED)
    atlas = np.frombuffer(base64.b64decode(found["data"]), np.uint8).reshape(*found["atlas"], 4)[..., 0].astype(float)
    faces = {name: atlas[y : y + h, x : x + w] for name in ("floor", "wall") for x, y, w, h in [found[name]]}
    return faces | {"half": np.array(found["half"]), "windows": np.array(found["windows"])}


def test_a_patch_of_sun_has_straight_edges(day: dict[str, NDArray[np.float64]]) -> None:
    """Where the linear filter crosses half of the brightness, by column; a texel's steps would be half a texel off."""
    crossed = []
    for column in day["floor"][8:44, 10:40].T:
        middle = (column.min() + column.max()) / 2
        row = int(np.argmax(column > middle))
        crossed.append(row - 1 + (middle - column[row - 1]) / (column[row] - column[row - 1]))
    x = np.arange(len(crossed))
    off = crossed - np.polyval(np.polyfit(x, crossed, 1), x)
    assert np.ptp(crossed) > 5 and np.abs(off).max() < 0.35 and off.std() < 0.16


def test_a_bright_window_does_not_shine_into_its_wall(day: dict[str, NDArray[np.float64]]) -> None:
    """At the sashes' outer edges, 7 cm beside the hole, as the linear filter reads them."""
    wall, (_, height, depth) = day["wall"], day["half"]
    rows, columns = wall.shape
    seen = []
    for _, start, end, _, _ in day["windows"][day["windows"][:, 0] == 0]:
        for along in (start - 0.07, end + 0.07):
            u = (along / (2 * depth) + 0.5) * (columns - 1)
            for up in (1.0, 1.5, 2.0):
                row = wall[round(up / height * (rows - 1))]
                seen.append(np.interp(u, np.arange(columns), row))
    assert wall.max() > 230  # a mirror shows bright windows
    assert len(seen) == 12 and max(seen) < np.median(wall) + 10
