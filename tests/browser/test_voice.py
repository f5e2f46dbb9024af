"""The page's voice: a microphone that is asked for, muted and given back."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from glsplat.data import default_avatar
from glsplat.extras.consent.file import OnFile
from glsplat.extras.consent.policy import ConsentPolicy
from glsplat.extras.speech.analysis import table
from glsplat.extras.speech.sound import Sound
from glsplat.net.options import ServerConfig
from glsplat.net.served_scene import gl_server
from glsplat.skinning.expression import ARKIT
from tests import needs
from tests.browser.conftest import _FLAGS, OpenPage
from tests.browser.flat_page import flat_page
from tests.browser.markers import Markers, offered, samples
from tests.browser.opened import FAKE_XR, WATCH, Opened
from tests.browser.vr import enter, settings, visit
from tests.extras.speech.sounds import vowels, wav_bytes

MAIN = """
import { ARKIT } from '/vr/draw/crowd.js';
import { Hurry } from '/vr/voice/panel.js';
import { OwnFace } from '/vr/show/here.js';
window.sides = (side, steps) => {
  const hurry = new Hurry();
  return steps.map(([speaks, render, now, seen]) => hurry.side(side, speaks, { render, encode: 10 }, now, seen));
};
window.faces = (steps) => {
  const face = new OwnFace();
  return steps.map(([now, answered, server]) => {
    Object.assign(face, { now, answered });
    const found = face.over(server && Float32Array.from(ARKIT, (name) => server[name] ?? 0));
    return found && Object.fromEntries(ARKIT.map((name, i) => [name, found[i]]).filter(([, weight]) => weight));
  });
};
"""
NAMES = {name for weights in table().visemes.values() for name in weights}


@pytest.fixture(scope="module")
def voice(chromium: Any) -> Iterator[Any]:
    """A page with the modules of MAIN."""
    with flat_page(chromium, MAIN, "window.faces") as page:
        yield page


def test_pictures_get_smaller_while_one_speaks_to_a_slow_server_and_whole_again_after(voice: Any) -> None:
    quick, slow = 40, 90  # of a picture, ms; 15 pictures a second leave 67

    def sides(side: int, *steps: tuple[bool, float, float] | tuple[bool, float, float, float]) -> list[int]:
        found: list[int] = voice.evaluate("([side, steps]) => sides(side, steps)", [side, [list(s) for s in steps]])
        return found

    assert sides(512, (False, slow, 0), (False, slow, 9000)) == [512, 512]  # nobody speaks
    assert sides(512, (True, quick, 0), (True, quick, 900)) == [512, 512]  # nobody waits
    some = [(True, slow, t) for t in (0.0, 100.0, 500.0, 1000.0)] + [(True, quick, 1500.0)]
    assert sides(512, *some) == [384, 384, 288, 288, 288]  # no smaller than 256
    assert sides(512, *some, (False, quick, 6000), (False, quick, 7000))[-2:] == [288, 512]
    # what is not seen goes first, at once, and comes back with who comes nearer
    unseen: list[tuple[bool, float, float, float]] = [(True, quick, t, 280) for t in (0.0, 16.0, 32.0, 2000.0)]
    assert sides(512, *unseen) == [280] * 4
    assert sides(512, *unseen, (True, 20, 3000.0, 900), (True, 20, 3016.0, 20))[-2:] == [512, 256]
    assert sides(512, *[(False, slow, t, seen) for _, _, t, seen in unseen]) == [512] * 4


@pytest.fixture(scope="module")
def listening(play: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A browser whose microphone plays two seconds of vowels, then two of silence, again and again."""
    file = tmp_path_factory.mktemp("voice") / "voice.wav"
    sound = np.concatenate([vowels(2, 48000), np.zeros(96000)])
    file.write_bytes(wav_bytes(Sound(sound.astype(np.float32), 48000)))
    flags = ["--use-fake-device-for-media-stream", f"--use-file-for-fake-audio-capture={file}"]
    browser = play.chromium.launch(
        executable_path=needs.program("chromium"),
        headless=True,
        args=[*_FLAGS, *flags, "--use-fake-ui-for-media-stream"],
    )
    yield browser
    browser.close()


def opened(browser: Any, address: str, scripts: str, size: int = 900, **values: Any) -> Opened:
    context = browser.new_context(viewport={"width": size, "height": size}, bypass_csp=True)
    context.add_init_script(settings(drawer=True, **values) + scripts)
    page = Opened(context.new_page())
    page.page.goto(address)
    page.until("window.glsplat?.stats().shown > 0")
    return page


def slow_page(browser: Any, address: str, **values: Any) -> Opened:
    page = opened(browser, address, SLOW, 240, **values)
    page.until("document.querySelector('#voice-talk')")
    page.page.evaluate("document.querySelector('#voice-talk').click()")
    page.until("document.querySelector('#voice-state').textContent === 'Listening.'")
    return page


# frames of the display a quarter of a second apart; of each request how many frames there were, and its jaw
SLOW = """
  window.frames = 0;
  window.asked = [];
  window.times = [];
  window.requestAnimationFrame = (then) => setTimeout(() => {
    window.frames++;
    then(performance.now() - 40); // when the frame began: it was busy since
  }, 250);
  window.cancelAnimationFrame = clearTimeout;
  window.Worker = class extends Worker {
    constructor(...what) {
      super(...what);
      this.addEventListener('message', (event) => {
        if (window.deaf && event.data.message) event.stopImmediatePropagation();
      });
    }

    postMessage(told, ...rest) {
      const { frame_id: id, pose, t } = told?.text ? JSON.parse(told.text) : {};
      if (id) window.asked.push([window.frames, pose?.expression?.jawOpen ?? 0]);
      if (id) window.times.push(t);
      super.postMessage(told, ...rest);
    }
  };"""


def test_a_mouth_that_moves_does_not_wait_for_the_next_frame(listening: Any, serve: Any) -> None:
    page = slow_page(listening, serve(Markers(lambda job: {"red": (0, 1.5, 0)}), offered=offered).page)
    page.js("window.asked.length = 0")
    page.until("window.asked.some(([, jaw]) => jaw > 0.1) && window.asked.filter(([, jaw]) => jaw === 0).length > 4")
    asked = page.js("window.asked")
    between = [b for a, b in pairwise(asked) if a[0] == b[0]]
    assert any(jaw > 0.1 for _, jaw in between), asked
    calm = [frame for frame, jaw in asked if jaw == 0]  # who is silent asks with each frame
    assert len(calm) <= 1.5 * len(set(calm)) + 2, asked
    times = page.js("window.times")
    assert times == sorted(times)
    page.js("Object.defineProperty(document, 'hidden', { value: true })")  # nobody sees it: frames alone ask
    page.js("window.asked.length = 0")
    page.until("window.asked.filter(([, jaw]) => jaw > 0.1).length > 4")
    frames = [frame for frame, _ in page.js("window.asked")]
    assert len(frames) == len(set(frames))
    assert not page.faults


def test_where_the_page_draws_ones_own_mouth_waits_for_no_answer(listening: Any, serve: Any) -> None:
    policy = ConsentPolicy()
    policy.add("default", [OnFile(nobody=True)])
    served = serve(
        config=ServerConfig(port=0),
        make=lambda config: gl_server(default_avatar(), replace(config, consent=policy), own_process=False),
    )
    page = slow_page(listening, served.page, drawn="here", place="plain")
    page.until("window.glsplat.stats().drawn.jaw > 0.1")
    page.js("window.deaf = true")  # no answer comes from here on
    page.until("window.glsplat.stats().drawn.jaw < 0.02")
    page.until("window.glsplat.stats().drawn.jaw > 0.1")
    assert page.stats()["drawn"]["by"] == "here" and not page.faults


def test_ones_own_face_is_what_is_said_now_over_what_the_server_adds(voice: Any) -> None:
    smiling = [0.0] * len(ARKIT)
    smiling[ARKIT.index("mouthSmileLeft")] = 0.5
    steps: list[tuple[Any, Any, Any, Any]] = [  # said now, said before, the server's answer to that, what is drawn
        (None, None, None, None),
        (None, None, {"eyeBlinkLeft": 1}, {"eyeBlinkLeft": 1}),
        ({"jawOpen": 0.5}, {}, None, {"jawOpen": 0.5}),
        (
            {"jawOpen": 0.5},
            {"jawOpen": 0.25},
            {"jawOpen": 0.25, "eyeBlinkLeft": 1},
            {"jawOpen": 0.5, "eyeBlinkLeft": 1},
        ),
        ({}, {"jawOpen": 0.25}, {"jawOpen": 0.25, "eyeBlinkLeft": 1}, {"eyeBlinkLeft": 1}),
        ({}, {}, {"jawOpen": 0.25}, {"jawOpen": 0.25}),  # somebody else's: a tracked face
        ({"jawOpen": 7, "nonsense": 1, "mouthFunnel": -2}, None, None, {"jawOpen": 1}),
        (smiling, {"jawOpen": 0.25}, {"jawOpen": 0.25}, {"mouthSmileLeft": 0.5}),
        ({}, {"jawOpen": 0.25}, {"jawOpen": 0.25}, None),
    ]
    assert voice.evaluate("(steps) => faces(steps)", [list(step[:3]) for step in steps]) == [s[3] for s in steps]


def test_who_speaks_moves_the_mouth_and_only_weights_leave(open_page: OpenPage, listening: Any, serve: Any) -> None:
    backend = Markers(lambda job: {"red": (0, 1.5, 0)})
    served = serve(backend, offered=offered)
    refused = visit(open_page, served)  # a browser without a microphone
    refused.page.click("#voice-talk")
    refused.until("document.querySelector('#voice-state').textContent.startsWith('Not listening')")
    refused.page.close()
    page = opened(listening, served.page, ";" + FAKE_XR + WATCH)

    def words(page: Opened) -> str:
        return page.js("document.querySelector('#voice').textContent")

    def said() -> dict[str, float]:
        newest = backend.requests[-1]
        return {} if newest.pose is None else dict(newest.pose.expression)

    page.until("document.querySelector('#voice')")
    assert not said() and "stays in this browser" in words(page)
    page.page.click("#voice-talk")
    page.meanwhile(lambda: said().get("jawOpen", 0) > 0.1)
    assert set(said()) <= NAMES and all(0 < weight <= 1 for weight in said().values())
    assert "Listening" in words(page)
    page.meanwhile(lambda: said().get("jawOpen", 0) < 0.02)  # the pause in what the microphone plays
    page.meanwhile(lambda: said().get("jawOpen", 0) > 0.1)
    page.page.click("#voice-mute")
    page.meanwhile(lambda: not said())
    assert "Muted" in words(page) and page.js("document.querySelector('#voice-mute').textContent") == "Unmute"
    page.page.click("#voice-mute")
    page.meanwhile(lambda: said().get("jawOpen", 0) > 0.1)
    enter(page)
    count = len(samples)
    page.meanwhile(lambda: any((s.expression or {}).get("jawOpen", 0) > 0.1 for s in list(samples.values())[count:]))
    page.js("document.querySelector('#voice-talk').click()")
    page.until("document.querySelector('#voice-talk').textContent.startsWith('Speak')")
    assert all(address.split("/")[2] == f"localhost:{served.port}" for address in page.requests)
    assert not page.faults
