"""What the page says an avatar may look at, where it draws by itself: who looks at it, from where the user is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.browser.flat_page import flat_page

MAIN = """
import { placing, serverEye, watcher } from '/vr/space/placing.js';
const eye = (x, y, z) => ({ transform: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1] });
window.seen = (view, head) => {
  const where = placing(view, eye(...head).transform);
  const views = [eye(head[0] - 0.03, head[1], head[2]), eye(head[0] + 0.03, head[1], head[2])];
  const place = serverEye(where, eye(...head).transform).slice(12, 15);
  return { face: watcher(views, where), eye: place, mirror: where.mirror };
};
"""
HEAD = [0.2, 1.6, 0.4]


@pytest.mark.parametrize(
    ("view", "face"), [("mirror", [0.2, 1.6, 0.4 - 2 * 1.2]), ("facing", [0.2, 1.6, 0.4 - 1.8]), ("own", HEAD)]
)
def test_the_face_is_where_the_eyes_of_a_picture_are(chromium: Any, view: str, face: list[float]) -> None:
    with flat_page(chromium, MAIN) as page:
        page.wait_for_function("window.seen !== undefined")
        found = page.evaluate("([view, head]) => seen(view, head)", [view, HEAD])
    assert np.array(found["face"]) == pytest.approx(face, abs=1e-3)
    eye = np.array(found["eye"]) * ([-1, 1, 1] if found["mirror"] else [1, 1, 1])  # the server turns it back
    assert eye == pytest.approx(face, abs=1e-3)
