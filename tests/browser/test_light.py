"""Light chosen on the page: that of the place, turned to where the avatar is; of the user's own room in passthrough."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.light.light import Light
from glsplat.net.backend import RenderJob
from glsplat.net.messages import WireOptions
from glsplat.net.server import ServerConfig
from tests.browser.conftest import OpenPage
from tests.browser.flat_page import flat_page
from tests.browser.markers import Markers, offered
from tests.browser.opened import Opened
from tests.browser.vr import enter, fresh, pose, rotation, steer, visit
from tests.light.lit import random_light

PLACES = ("day", "studio", "night")
NORMALS = np.random.default_rng(4).normal(size=(40, 3))
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)
EXPOSURE = 1.5  # of all places alike, as place/light.js has it
HEAD = pose([0.1, 1.65, 0.2], yaw=25)


def nothing(job: RenderJob) -> dict[str, Any]:
    return {"red": [0.1, 1.2, 0.2]}


def lit(light: Light, normals: NDArray[np.float64] = NORMALS) -> NDArray[np.float64]:
    """[N, 3] light over pi on surfaces with those normals."""
    out = light.irradiance(normals)
    if light.sun_direction is not None:
        out = out + np.maximum(normals @ light.sun_direction, 0)[:, None] * light.sun_colour / np.pi
    return np.asarray(out)


def of_place(page: Any, name: str) -> Light:
    """What place/light.js makes of it."""
    said = page.evaluate("(name) => import('/vr/place/light.js').then((m) => m.lightOf(name))", name)
    return Light.from_json({key: value for key, value in said.items() if value is not None})


def sent(page: Opened, backend: Markers) -> Light | None:
    """The light of a request that was sent from now on; the flat page's frames come by themselves."""
    before = page.stats()["sentId"]
    page.until(f"window.glsplat.stats().shownId > {before}")
    return backend.asked(page.stats()["shownId"]).options.light


def test_a_place_lights_as_its_walls_are_lit(chromium: Any) -> None:
    """The nine numbers and the lamp against what the page bakes into floor and walls, and where its lamps are."""
    with flat_page(chromium) as page:
        asked = [[float(v) for v in normal] for normal in NORMALS]
        for name in PLACES:
            baked = page.evaluate(
                """async ([name, normals]) => {
                  const { lightIn } = await import('/vr/place/bake.js');
                  const { LOOKS } = await import('/vr/place/looks.js');
                  const falls = lightIn(LOOKS[name]);
                  return normals.map((normal) => falls([0, 1.2, 0], normal));
                }""",
                [name, asked],
            )
            light = of_place(page, name)
            assert np.abs(lit(light) / EXPOSURE - baked).max() < 0.05
        day, night = (lit(of_place(page, name), np.array([[0.0, 0, 1]])).mean() for name in ("day", "night"))
        assert 0.45 * day < night < 0.75 * day  # who faces a lamp at night is seen, and is darker than by day
        sun = of_place(page, "studio").sun_direction
        assert sun is not None and sun[1] > 0.95  # from above
        assert of_place(page, "day").sun_direction is None  # it comes in by the windows, and not to where one stands
        left, right = lit(of_place(page, "day"), np.array([[-1.0, 0, 0], [1, 0, 0]])).mean(axis=1)
        assert left > 1.2 * right  # the side of the windows
        assert page.evaluate("import('/vr/place/light.js').then((m) => m.lightOf('plain'))") is None


def test_the_flat_page_asks_for_the_light_of_the_place_that_it_shows(open_page: OpenPage, serve: Any) -> None:
    backend = Markers(nothing)
    page = visit(open_page, serve(backend, offered=offered), {"place": "night"})
    page.until("window.glsplat.stats().shownId > 2")
    found = sent(page, backend)
    assert found is not None and np.abs(lit(found) - lit(of_place(page.page, "night"))).max() < 1e-3
    page.page.select_option("#place", "studio")
    found = sent(page, backend)
    assert found is not None and np.abs(lit(found) - lit(of_place(page.page, "studio"))).max() < 1e-3
    page.page.uncheck("#light")
    assert sent(page, backend) is None
    backend, own = Markers(nothing), random_light(7)
    served = serve(backend, ServerConfig(port=0, wire=WireOptions(light=own)), offered=offered)
    page = visit(open_page, served, {"place": "night"})  # a server that was started with a light means that one
    page.until("window.glsplat.stats().shownId > 2")
    assert sent(page, backend) is None and not page.page.is_checked("#light")
    page.page.check("#light")
    assert sent(page, backend) is not None


def test_in_vr_it_comes_from_where_the_place_has_it(open_page: OpenPage, serve: Any) -> None:
    """Before a mirror the user is lit in the room; an avatar that faces them is turned, and the light is not."""
    backend = Markers(nothing)
    page = visit(open_page, serve(backend, offered=offered), {"view": "mirror", "place": "day", "size": 256})
    steer(page, head=HEAD, side=128)
    enter(page, run=False)
    place = of_place(page.page, "day")
    for view, wanted in (("mirror", place), ("facing", place.turned(np.diag([-1.0, 1, -1])))):
        page.page.select_option("#view", view)
        fresh(page)
        found = backend.asked(page.stats()["shownId"]).options.light
        assert found is not None and np.abs(lit(found) - lit(wanted)).max() < 1e-3


def test_in_passthrough_it_is_that_of_the_room_around(open_page: OpenPage, serve: Any) -> None:
    backend, around = Markers(nothing), random_light(11)
    page = visit(open_page, serve(backend, offered=offered), {"view": "mirror", "place": "night"})
    features = ["viewer", "local", "local-floor", "light-estimation"]
    probe = pose([0.4, 1.5, -0.2], yaw=70, pitch=20)
    assert around.sun_direction is not None
    told = {
        "sh": around.ambient.ravel().tolist(),
        "direction": (2.5 * around.sun_direction).tolist(),
        "intensity": around.sun_colour.tolist(),
        "probe": probe,
    }
    steer(page, head=HEAD, side=128, features=features, light=told)
    enter(page, "ar", run=False)
    fresh(page)

    def asked() -> Light | None:
        fresh(page)
        return backend.asked(page.stats()["shownId"]).options.light

    found = asked()
    wanted = around.turned(rotation(probe[3:]))
    assert found is not None and np.abs(lit(found) - lit(wanted)).max() < 1e-3
    assert found.sun_direction is not None
    for broken in (None, {**told, "sh": [1.0] * 26}, {**told, "sh": [1e9] * 27}, {**told, "probe": None}):
        steer(page, light=broken)
        assert asked() is None
    steer(page, light={**told, "intensity": [0, 0, 0]})
    found = asked()
    assert found is not None and found.sun_direction is None
