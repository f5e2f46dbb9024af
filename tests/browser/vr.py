"""Entering VR with the page, moving the fake headset, and the geometry that pictures are held against.

Poses are [x, y, z, qx, qy, qz, qw] in the room: metres, y up, the floor at 0. Angles in degrees.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tests.browser.opened import Opened, decoded
from tests.browser.served import Served

__all__ = [
    "SIDE",
    "angle",
    "centroid",
    "enter",
    "fresh",
    "hands",
    "pose",
    "project",
    "see",
    "settings",
    "steer",
    "visit",
]

SIDE = 1024  # pixels of a fake eye
Vector = NDArray[np.float64]


def settings(**values: Any) -> str:
    """A script that makes a page begin with these settings."""
    kept = (
        f"localStorage.getItem('glsplat.settings') ?? localStorage.setItem('glsplat.settings', '{json.dumps(values)}')"
    )
    return f"if (location.protocol.startsWith('http') && window === window.top) {kept}"  # others have no storage


def visit(open_page: Any, served: Served, values: dict[str, Any] | None = None, **options: Any) -> Opened:
    """The page of a server, with these settings; in the dark, where geometry is measured, its drawer open."""
    init = settings(**({"size": 512, "driver": "rest", "place": "plain", "drawer": True} | (values or {})))
    address = options.pop("address", served.page)
    return open_page(address, init=init, **options)


def enter(page: Opened, mode: str = "vr", run: bool = True) -> Opened:
    """Into VR or AR by the button; ``run``: the fake headset's frames come by themselves from here on."""
    page.until(f"!document.querySelector('#enter-{mode}').disabled")
    page.page.click(f"#enter-{mode}")
    page.until("window.glsplat.stats().session !== 'none'")
    if run:
        page.js("fakeXR.run()")
    return page


def pose(place: ArrayLike, yaw: float = 0.0, pitch: float = 0.0) -> list[float]:
    """``yaw`` to the left about the vertical, then ``pitch`` upwards."""
    y, p = np.radians([yaw, pitch]) / 2
    quat = [np.cos(y) * np.sin(p), np.sin(y) * np.cos(p), -np.sin(y) * np.sin(p), np.cos(y) * np.cos(p)]
    return [*map(float, np.asarray(place, float)), *map(float, quat)]


def hands(left: list[float] | None, right: list[float] | None) -> dict[str, Any]:
    """25 joints a hand whose wrist has that pose: open hands, -z to the middle finger, y out of the back."""
    return {side: at and {"joints": _hand(at, sign)} for side, at, sign in (("left", left, 1), ("right", right, -1))}


def _hand(wrist: list[float], thumb: int) -> list[list[float]]:
    local = [[0.0, 0.0, 0.0]]
    local += [[thumb * (0.02 + 0.015 * i), -0.005, -0.03 - 0.025 * i] for i in range(4)]
    for finger in range(4):
        aside = thumb * (0.025 - 0.018 * finger)
        local += [[aside, 0.0, -z] for z in (0.02, 0.085, 0.125, 0.15, 0.17)]
    turn = rotation(wrist[3:])
    return [[*(turn @ point + wrist[:3]), *wrist[3:], 0.008] for point in np.array(local)]


def rotation(quat: ArrayLike) -> Vector:
    """[3, 3] of a unit quaternion x y z w."""
    x, y, z, w = np.asarray(quat, float)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def steer(page: Opened, **values: Any) -> None:
    """Set what the fake device has: head, hands, controllers, buttons, body, input, cant, ipd."""
    page.js("(values) => Object.assign(fakeXR.device, values)", values)


def fresh(page: Opened, timeout: float = 60.0) -> None:
    """A frame now and then until a picture of what the device has now is on the screen; it then stands still."""
    page.js("fakeXR.stop()")
    for _ in range(2):  # the second one knows the box of what the first one showed
        # what is under way already may be of what the device had before
        before = page.stats()["sentId"]
        page.until(f"(() => {{ fakeXR.step(); return window.glsplat.stats().sentId > {before}; }})()", timeout)
        sent = page.stats()["sentId"]
        page.until(f"(() => {{ fakeXR.step(); return window.glsplat.stats().shownId >= {sent}; }})()", timeout)


def see(page: Opened) -> dict[str, Any]:
    """One more frame, of one moment: {"left", "right": pixels, "eyes": {side: (room from eye, projection)}, "stats"}"""
    found = page.js("""() => {
      fakeXR.step();
      return {left: fakeXR.pixels('left'), right: fakeXR.pixels('right'), eyes: fakeXR.last.eyes,
        time: fakeXR.last.time, stats: window.glsplat.stats()};
    }""")
    matrices = {side: tuple(np.reshape(eye[k], (4, 4)).T for k in ("matrix", "projection"))
                for side, eye in found["eyes"].items()}  # fmt: skip
    return found | {side: decoded(found[side]) for side in ("left", "right")} | {"eyes": matrices}


def project(eye: tuple[Vector, Vector], point: ArrayLike, side: int = SIDE) -> Vector:
    """[2] pixel of a point of the room in an eye's picture, (0, 0) the upper left corner of the first one."""
    matrix, projection = eye
    clip = projection @ np.linalg.inv(matrix) @ np.append(np.asarray(point, float), 1.0)
    assert clip[3] > 0, "behind the eye"
    return (np.array([clip[0], -clip[1]]) / clip[3] + 1) * side / 2


def centroid(image: NDArray[np.uint8], colour: str, least: float = 60.0) -> Vector:
    """[2] pixel of the middle of what is "red", "green" or "blue" by more than ``least``."""
    channels = image[..., :3].astype(float)
    index = ("red", "green", "blue").index(colour)
    excess = channels[..., index] - np.delete(channels, index, 2).max(2) - least
    weight = np.maximum(excess, 0)
    assert weight.sum() > 50, f"nothing {colour} in the picture"
    y, x = np.nonzero(weight)
    return np.average(np.stack([x, y], 1) + 0.5, axis=0, weights=weight[y, x])


def angle(eye: tuple[Vector, Vector], a: ArrayLike, b: ArrayLike, side: int = SIDE) -> float:
    """Degrees between two pixels of an eye's picture."""
    _, projection = eye
    rays = []
    for pixel in (a, b):
        x, y = np.asarray(pixel, float) * 2 / side - 1
        ray = np.array([(x + projection[0, 2]) / projection[0, 0], (-y + projection[1, 2]) / projection[1, 1], -1.0])
        rays.append(ray / np.linalg.norm(ray))
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(*rays)), rays[0] @ rays[1])))
