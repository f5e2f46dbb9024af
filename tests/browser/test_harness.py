"""The tools of these tests hold what the tests rest on: stamps, the fake headset, watching eyes."""

from __future__ import annotations

import math

import numpy as np
import simplejpeg

from glsplat.net.codec.encode import encode_picture
from tests.browser.opened import Opened
from tests.browser.stored import read_stamp, stamp


def test_a_stamp_survives_the_codec() -> None:
    for number in (0, 1, 77, 2**19 - 1, 300_001):
        for eye in (0, 1):
            image = np.random.default_rng(1).integers(0, 255, (128, 160, 4), np.uint8)
            stamp(image, number, eye)
            shown = simplejpeg.decode_jpeg(encode_picture(image, 30))
            assert read_stamp(shown) == (number, eye)
    assert read_stamp(np.zeros((128, 160, 3), np.uint8)) is None
    assert read_stamp(np.full((128, 160, 3), 255, np.uint8)) is None


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


def test_uploads_are_read_where_they_lie(modules: Opened) -> None:
    image = np.zeros((256, 256, 4), np.uint8)
    stamp(image, 4711, 1)
    jpeg = list(encode_picture(image, 80))
    modules.js(
        """async (jpeg) => {
          const gl = document.createElement('canvas').getContext('webgl2');
          const options = {premultiplyAlpha: 'none', colorSpaceConversion: 'none'};
          const bitmap = await createImageBitmap(new Blob([new Uint8Array(jpeg)]), options);
          gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
          gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
          gl.bindTexture(gl.TEXTURE_2D_ARRAY, gl.createTexture());
          gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.RGBA8, 300, 300, 2);
          gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 9, 7, 1, 256, 256, 1, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
          bitmap.close();
          bitmap.close();
        }""",
        jpeg,
    )
    uploads = modules.js("watch.uploads")
    assert [(u["id"], u["eye"], u["width"]) for u in uploads] == [(4711, 1, 256)] * 2
    assert modules.js("[watch.opened, watch.closed]") == [1, 1]


def test_a_complaint_of_the_page_is_a_fault(modules: Opened) -> None:
    modules.js("console.error('so it goes')")
    modules.js("setTimeout(() => { throw new Error('thrown'); }, 0)")
    modules.meanwhile(lambda: len(modules.unexpected()) >= 2)
    assert len(modules.unexpected()) == 2, modules.faults
    modules.allowed += ["so it goes", "thrown"]
    assert not modules.unexpected()
