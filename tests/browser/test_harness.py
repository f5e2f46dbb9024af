"""The tools of these tests hold what the tests rest on: the fake headset, and complaints that are noticed."""

from __future__ import annotations

import math

import numpy as np

from tests.browser.opened import Opened


def test_the_fake_eyes_are_as_told(modules: Opened) -> None:
    page = modules
    page.js("""async () => {
      const gl = document.createElement('canvas').getContext('webgl2', {xrCompatible: true});
      const button = document.body.appendChild(document.createElement('button'));
      button.id = 'go';
      button.onclick = async () => {
        window.session = await navigator.xr.requestSession('immersive-vr', {requiredFeatures: ['local-floor']});
        session.updateRenderState({baseLayer: new XRWebGLLayer(session, gl), depthNear: 0.05, depthFar: 50});
        window.space = await session.requestReferenceSpace('local-floor');
      };
    }""")
    page.page.click("#go")
    page.until("window.space")
    page.js("fakeXR.device.head = [0.1, 1.7, 0.2, 0, Math.sin(0.3), 0, Math.cos(0.3)]")
    page.js("""() => session.requestAnimationFrame((time, frame) => {
      const {views, transform} = frame.getViewerPose(space);
      window.seen = {time, head: [...transform.matrix], views: views.map((view) => ({eye: view.eye,
        matrix: [...view.transform.matrix], P: [...view.projectionMatrix],
        port: (({x, y, width, height}) => [x, y, width, height])(session.renderState.baseLayer.getViewport(view))}))};
    })""")
    assert page.js("fakeXR.step(1234.5)") is True
    seen = page.js("window.seen")
    assert seen["time"] == 1234.5
    left, right = seen["views"]
    assert (left["eye"], left["port"]) == ("left", [0, 0, 1024, 1024])
    assert (right["eye"], right["port"]) == ("right", [1024, 0, 1024, 1024])
    for view, angles in ((left, (54, 40)), (right, (40, 54))):
        P = np.reshape(view["P"], (4, 4)).T
        edges = [(P[0, 2] - 1) / P[0, 0], (P[0, 2] + 1) / P[0, 0], (P[1, 2] - 1) / P[1, 1], (P[1, 2] + 1) / P[1, 1]]
        tangents = [math.tan(math.radians(a)) for a in (-angles[0], angles[1], -53, 44)]
        np.testing.assert_allclose(edges, tangents, rtol=1e-6)
        near, far = P[2, 3] / (P[2, 2] - 1), P[2, 3] / (P[2, 2] + 1)
        np.testing.assert_allclose([near, far], [0.05, 50], rtol=1e-4)
    apart = np.subtract(right["matrix"][12:15], left["matrix"][12:15])
    np.testing.assert_allclose(apart, 0.063 * np.array([math.cos(0.6), 0, -math.sin(0.6)]), atol=1e-6)
    np.testing.assert_allclose(seen["head"][12:15], [0.1, 1.7, 0.2], atol=1e-6)


def test_a_complaint_of_the_page_is_a_fault(modules: Opened) -> None:
    modules.js("console.error('so it goes')")
    modules.js("setTimeout(() => { throw new Error('thrown'); }, 0)")
    modules.meanwhile(lambda: len(modules.unexpected()) >= 2)
    assert len(modules.unexpected()) == 2, modules.faults
    modules.allowed += ["so it goes", "thrown"]
    assert not modules.unexpected()
