"""Voice between pages of a room over loopback, with Chromium's fake microphone."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from glsplat.extras.speech.sound import Sound
from glsplat.extras.voice import Voice
from glsplat.net.backend import RenderJob
from glsplat.net.options import ServerConfig
from glsplat.net.served_scene import server_of
from tests import needs
from tests.browser.conftest import _FLAGS
from tests.browser.flat_page import flat_page
from tests.browser.markers import Markers
from tests.browser.opened import Opened
from tests.browser.served import Served
from tests.browser.test_rooms import OFFERED, cut_off
from tests.browser.vr import settings
from tests.extras.speech.sounds import vowels, wav_bytes

RATE = 48000
FAKE = ["--use-fake-device-for-media-stream", "--autoplay-policy=no-user-gesture-required"]
ALLOWED = "--use-fake-ui-for-media-stream"

# few frames of the display, which cost more than all else; what comes out of the newest voices, a root mean square;
# bytes of sound sent; options that connections get besides
WATCH = """;
(() => {
  window.requestAnimationFrame = (then) => setTimeout(() => then(performance.now()), 200);
  window.cancelAnimationFrame = clearTimeout;
  const rms = (node) => {
    const samples = new Float32Array(node.fftSize);
    node.getFloatTimeDomainData(samples);
    return Math.hypot(...samples) / Math.sqrt(samples.length);
  };
  window.voices = [];
  window.PannerNode = class extends PannerNode {
    constructor(context, options) {
      super(context, options);
      this.meter = new AnalyserNode(context, { fftSize: 4096 });
      this.connect(this.meter);
      window.voices.push(this);
    }
  };
  window.heard = () => Math.max(0, ...voices.slice(-3).map(({ meter }) => rms(meter)));
  window.peers = [];
  window.RTCPeerConnection = class extends RTCPeerConnection {
    constructor(configuration) {
      super({ ...configuration, ...window.forced });
      window.peers.push(this);
    }
  };
  window.sent = async () => {
    const reports = await Promise.all(peers.map((one) => one.getStats()));
    const sounds = reports.flatMap((one) => [...one.values()]).filter(({ type }) => type === 'outbound-rtp');
    return sounds.reduce((sum, one) => sum + one.bytesSent, 0);
  };
})();
"""


@pytest.fixture(scope="module")
def wav(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A second of a vowel, a second of silence."""
    sound = np.concatenate([vowels(1, RATE, each=9), np.zeros(RATE)])
    file = tmp_path_factory.mktemp("talk") / "voice.wav"
    file.write_bytes(wav_bytes(Sound(sound.astype(np.float32), RATE)))
    return str(file)


@pytest.fixture(scope="module")
def speaking(play: Any, wav: str) -> Iterator[Any]:
    """A browser whose microphone speaks, and which does not ask whether it may."""
    flags = [*_FLAGS, *FAKE, ALLOWED, f"--use-file-for-fake-audio-capture={wav}"]
    browser = play.chromium.launch(executable_path=needs.program("chromium"), headless=True, args=flags)
    yield browser
    browser.close()


@pytest.fixture
def backend() -> Markers:
    return Markers(lambda job: {"red": (0, 1.5, 0)})


@pytest.fixture
def lab(serve: Any, backend: Markers) -> Served:
    """A room of four, with voice."""
    config = ServerConfig(port=0, rooms={"lab": 4, "hall": 4})
    served: Served = serve(make=lambda config: server_of(backend, config, OFFERED, [Voice()]), config=config)
    return served


@pytest.fixture
def member(speaking: Any, lab: Served) -> Iterator[Any]:
    """``member(name, talks=True, browser=..., script="")``: a page in the room."""
    pages: list[Opened] = []
    contexts: list[Any] = []

    def open_(name: str, talks: bool = True, browser: Any = speaking, script: str = "", **kept: Any) -> Opened:
        context = browser.new_context(viewport={"width": 320, "height": 240})
        contexts.append(context)
        values = {"room": "lab", "name": name, "size": 512, "driver": "rest", "place": "plain", "drawer": True} | kept
        context.add_init_script(settings(**values) + WATCH + script)
        page = Opened(context.new_page())
        pages.append(page)
        page.page.goto(lab.page)
        page.until("window.glsplat?.stats().shown > 0")
        page.until("document.querySelector('#talk')?.hidden === false")
        if talks:
            talk(page)
        return page

    yield open_
    for context in contexts:
        context.close()
    assert not [fault for page in pages for fault in page.faults]


def click(page: Opened, *names: str) -> None:
    for name in names:
        page.js("(name) => document.getElementById(name).click()", name)


def talk(page: Opened) -> None:
    click(page, "talk-join", "talk-yes")
    page.until("document.querySelector('#talk-state').textContent.startsWith('They ')")


def people(page: Opened) -> list[str]:
    found: list[str] = page.js("[...document.querySelectorAll('#talk-people li')].map((one) => one.textContent)")
    return found


def names(page: Opened) -> list[str]:
    """The others to whom there is a path."""
    return sorted(line.removesuffix(": speaks") for line in people(page) if "connecting" not in line)


def hears(page: Opened) -> None:
    page.until("heard() > 0.01")


def test_two_pages_hear_each_other_and_the_server_no_sound(member: Any, lab: Served, backend: Markers) -> None:
    ann, bob = member("Ann"), member("Bob", talks=False)
    words = bob.js("document.querySelector('#talk-ask').textContent")
    assert "IP address" in words and "recorded" in words
    click(bob, "talk-join", "talk-no")
    assert lab.stats()["talk"]["people"] == 1 and not bob.js("peers.length")
    talk(bob)
    for page in (ann, bob):
        hears(page)
    ann.meanwhile(lambda: any("speaks" in line for line in people(ann)))
    signals = lab.stats()["talk"]
    before = bob.js("sent()")
    bob.until(f"sent().then((bytes) => bytes > {before + 20_000})")  # of sound, between the pages
    assert lab.stats()["talk"] == signals and signals["bytes"] < 20_000

    def jaw() -> float:  # Ann's, in Bob's pictures
        jobs = [one for one in backend.requests.values() if one.room is not None and one.room.viewer == 2]
        poses = [one.pose for job in jobs[-1:] if job.room is not None for one in job.room.people if one.name == "Ann"]
        return max((dict(pose.expression).get("jawOpen", 0.0) for pose in poses if pose is not None), default=0.0)

    bob.meanwhile(lambda: jaw() > 0.1)  # lips by the same microphone ...
    click(ann, "voice-mute")
    bob.meanwhile(lambda: jaw() == 0 and bob.js("heard()") < 1e-3)  # ... and closed together with it
    # Ann's mouth, from Bob's camera: across the room's middle, 2.4 m from his place
    seen: RenderJob = backend.requests[max(backend.requests)]
    place = bob.js("((one) => [one.positionX, one.positionY, one.positionZ].map(({ value }) => value))(voices.at(-1))")
    jobs = [one for one in backend.requests.values() if one.room is not None and one.room.viewer == 2]
    assert seen.room is not None and jobs[-1].room is not None
    eye = jobs[-1].cameras[0].viewmat  # room to camera, y down, z ahead
    anns = next(one for one in jobs[-1].room.people if one.name == "Ann").transform[:3, 3] + (0, 1.5, 0)
    assert place == pytest.approx(np.diag([1, -1, -1]) @ (eye[:3, :3] @ anns + eye[:3, 3]), abs=0.02)


def test_three_pages_join_leave_come_back_mute_and_push_to_talk(member: Any, lab: Served) -> None:
    ann, bob, cy = (member(name) for name in ("Ann", "Bob", "Cy"))
    ann.meanwhile(lambda: [names(page) for page in (ann, bob, cy)] == [["Bob", "Cy"], ["Ann", "Cy"], ["Ann", "Bob"]])
    click(cy, "talk-join")
    ann.meanwhile(lambda: names(ann) == ["Bob"] and names(bob) == ["Ann"])
    assert cy.js("document.querySelector('#talk-people').textContent") == "" and lab.stats()["talk"]["people"] == 2
    cut_off(lab)  # Ann's
    ann.until("window.glsplat.stats().reconnects === 1")
    ann.meanwhile(lambda: names(ann) == ["Bob"] and names(bob) == ["Ann"])
    hears(bob)
    click(ann, "talk-push")
    bob.until("heard() < 1e-3")
    assert "muted" in ann.js("document.querySelector('#talk-state').textContent")
    ann.js("document.activeElement.blur()")
    ann.page.keyboard.down("Space")
    hears(bob)
    ann.page.keyboard.up("Space")
    bob.until("heard() < 1e-3")
    hold = "(type) => document.getElementById('talk-hold').dispatchEvent(new Event(type))"
    ann.js(hold, "pointerdown")
    hears(bob)
    ann.js(hold, "pointerup")
    bob.until("heard() < 1e-3")
    bob.page.select_option("#room", "hall")  # agreed to was the lab
    ann.meanwhile(lambda: people(ann) == [])
    bob.until("document.querySelector('#talk-join').textContent === 'Talk with this room'")
    bob.page.select_option("#room", "")
    bob.until("document.querySelector('#talk').hidden")


def test_who_has_no_microphone_hears_the_others(member: Any, chromium: Any) -> None:
    member("Ann")
    bob = member("Bob", browser=chromium)  # which has none, and allows none
    assert bob.js("document.querySelector('#talk-state').textContent").startswith("They do not hear you: ")
    hears(bob)


def test_without_a_path_a_sentence_says_so(member: Any) -> None:
    ann = member("Ann", script="window.forced = { iceTransportPolicy: 'relay' };")  # and there is no relay
    bob = member("Bob")
    for page in (ann, bob):
        page.until("document.querySelector('#talk-people').textContent.includes('No path between your browsers')")


MAIN = """
import { Peer } from '/vr/talk/peer.js';
window.ready = (async () => {
  const context = new AudioContext();
  const tone = new OscillatorNode(context, { frequency: 500 });
  const mic = new MediaStreamAudioDestinationNode(context);
  tone.connect(mic);
  tone.start();
  const [track] = mic.stream.getAudioTracks();
  const peer = (offers, track, send) =>
    new Peer({ name: '' }, { offers, track, send, configuration: {}, context, changed() {} });
  const first = peer(true, track, (text) => second.receive(text));
  const second = peer(false, null, (text) => first.receive(text));
  const garbage = ['', 'null', '{}', '[1, null]', '[{"sdp": "v=0"}]', '[{"candidate": {"candidate": 7}}]'];
  for (const text of garbage) first.receive(text);
  const sides = new ChannelSplitterNode(context, { numberOfOutputs: 2 });
  second.out.connect(sides);
  const meters = [0, 1].map((side) => {
    const meter = new AnalyserNode(context, { fftSize: 32768 });
    sides.connect(meter, side);
    return meter;
  });
  window.loud = () => [second.meter, ...meters].map((meter) => {
    const samples = new Float32Array(meter.fftSize);
    meter.getFloatTimeDomainData(samples);
    return Math.hypot(...samples) / Math.sqrt(samples.length);
  });
  window.place = (...at) => second.place(at);
  window.path = () => second.path;
})();
"""


def test_a_voice_falls_by_6_db_for_twice_as_far_and_comes_from_its_side(speaking: Any) -> None:
    with flat_page(speaking, MAIN, "window.loud && path() === 'open' && loud()[0] > 0.1") as page:

        def heard(*at: float) -> tuple[float, float]:
            """Levels of both ears by that before the panner, dB, once they have settled."""
            page.evaluate("(at) => place(...at)", at)
            before = None
            for _ in range(200):
                page.wait_for_timeout(800)  # longer than the meters' window
                direct, left, right = page.evaluate("loud()")
                found = (20 * np.log10(left / direct), 20 * np.log10(right / direct))
                if before is not None and np.abs(np.subtract(found, before)).max() < 0.3:
                    return found
                before = found
            raise AssertionError("the level does not settle")

        near, far, farther = (np.mean(heard(0, 0, -metres)) for metres in (1, 2, 4))
        assert near - far == pytest.approx(6, abs=1) and near - farther == pytest.approx(12, abs=1.5)
        left, right = heard(-1, 0, 0)
        assert left > right + 6
        left, right = heard(1, 0, 0)
        assert right > left + 6
