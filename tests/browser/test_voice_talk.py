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
PATIENCE_S = 240.0  # for what takes a second on an idle machine
FAKE = ["--use-fake-device-for-media-stream", "--autoplay-policy=no-user-gesture-required"]
ALLOWED = "--use-fake-ui-for-media-stream"

# few frames of the display, which cost more than all else; what comes out of the newest voice, a root mean square;
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
  window.heard = () => (voices.length ? rms(voices.at(-1).meter) : 0);
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


# the page without pictures: a connection that asks for tiny ones, and the controls
LIGHT = """
import { Connection } from '/vr/stream/connection.js';
import { addTalk } from '/vr/talk/panel.js';
import { addVoice } from '/vr/voice/panel.js';
const name = location.hash.slice(1);
const connection = new Connection(() => ({ room: 'lab', name }));
const stage = { info: {}, renderedBy: { by: 'server' }, onFrame() {}, late: () => 120 };
const voice = addVoice(document.getElementById('controls'), stage);
const places = ['invite', 'controls'].map((id) => document.getElementById(id));
const { talk, offered } = addTalk(...places, { connection, voice, stage, relay: false });
const eyes = [{ viewmat: [1, 0, 0, 0, 0, -1, 0, 1.5, 0, 0, -1, 0, 0, 0, 0, 1], K: [9, 9, 8, 8] }];
connection.addEventListener('reply', ({ detail }) => (stage.info = detail.reply.info));
setInterval(() => {
  stage.onFrame([{ transform: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 1.5, 0, 1] }]);
  connection.send({ eyes, size: [16, 16], pose: voice.speaks({ trans: [0, 0, 0] }) });
}, 250);
document.getElementById('panel').hidden = false;
window.entered = offered;
window.opened = () => connection.opened;
offered('lab');
connection.restart();
"""


@pytest.fixture
def member(speaking: Any, lab: Served) -> Iterator[Any]:
    """``member(name, talks=True, whole=False, browser=..., script="")``: a page in the room."""
    pages: list[Opened] = []
    contexts: list[Any] = []

    def open_(name: str, talks: bool = True, whole: bool = False, browser: Any = speaking, script: str = "") -> Opened:
        context = browser.new_context(viewport={"width": 320, "height": 240})
        context.set_default_timeout(PATIENCE_S * 1e3)
        contexts.append(context)
        kept = {"room": "lab", "name": name, "size": 512, "driver": "rest", "place": "plain", "drawer": True}
        context.add_init_script(settings(**kept) + WATCH + script)
        if not whole:
            context.route("**/vr/main.js", lambda route: route.fulfill(body=LIGHT, content_type="text/javascript"))
        page = Opened(context.new_page())
        pages.append(page)
        page.page.goto(f"{lab.page}/#{name}")
        page.until("document.querySelector('#talk')?.hidden === false", PATIENCE_S)
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
    page.until("document.querySelector('#talk-state').textContent.startsWith('They ')", PATIENCE_S)


def people(page: Opened) -> list[str]:
    found: list[str] = page.js("[...document.querySelectorAll('#talk-people li')].map((one) => one.textContent)")
    return found


def names(page: Opened) -> list[str]:
    """The others to whom there is a path."""
    return sorted(line.removesuffix(": speaks") for line in people(page) if "connecting" not in line)


def hears(page: Opened) -> None:
    page.until("heard() > 0.01", PATIENCE_S)


def silent(page: Opened) -> None:
    """Wait for a silence that is longer than those of the microphone's file."""
    quiet = [1.0] * 8

    def lasts() -> bool:
        page.wait(0.3)
        quiet[:] = [*quiet[1:], page.js("heard()")]
        return max(quiet) < 1e-3

    page.meanwhile(lasts, PATIENCE_S)


def test_two_pages_hear_each_other_and_the_server_no_sound(member: Any, lab: Served, backend: Markers) -> None:
    ann, bob = member("Ann"), member("Bob", talks=False, whole=True)
    assert bob.js("document.querySelector('.tools button:not([hidden])').id") == "talk-join"
    words = bob.js("document.querySelector('#talk-ask').textContent")
    assert "IP address" in words and "recorded" in words
    click(bob, "talk-join", "talk-no")
    assert lab.stats()["talk"]["people"] == 1 and not bob.js("peers.length")
    talk(bob)
    for page in (ann, bob):
        hears(page)
    ann.meanwhile(lambda: any("speaks" in line for line in people(ann)), PATIENCE_S)
    assert ann.js("peers.at(-1).getReceivers()[0].jitterBufferTarget") == 100  # her page says that lips are 120 ms late
    signals = lab.stats()["talk"]
    before = bob.js("sent()")
    bob.until(f"sent().then((bytes) => bytes > {before + 20_000})", PATIENCE_S)  # of sound, between the pages
    assert lab.stats()["talk"] == signals and signals["bytes"] < 20_000

    def jaw() -> float:  # Ann's, in Bob's pictures
        jobs = [one for one in backend.requests if one.room is not None and one.room.viewer == 2]
        poses = [one.pose for job in jobs[-1:] if job.room is not None for one in job.room.people if one.name == "Ann"]
        return max((dict(pose.expression).get("jawOpen", 0.0) for pose in poses if pose is not None), default=0.0)

    bob.meanwhile(lambda: jaw() > 0.1, PATIENCE_S)  # lips by the same microphone ...
    click(ann, "voice-mute")
    bob.meanwhile(lambda: jaw() == 0 and bob.js("heard()") < 1e-3, PATIENCE_S)  # ... and closed together with it
    # Ann's head, from Bob's camera: across the room's middle, 2.4 m from his place
    seen: RenderJob = backend.requests[-1]
    place = bob.js("((one) => [one.positionX, one.positionY, one.positionZ].map(({ value }) => value))(voices.at(-1))")
    jobs = [one for one in backend.requests if one.room is not None and one.room.viewer == 2]
    assert seen.room is not None and jobs[-1].room is not None
    eye = jobs[-1].cameras[0].viewmat  # room to camera, y down, z ahead
    person = next(one for one in jobs[-1].room.people if one.name == "Ann")
    assert person.head is not None
    anns = person.transform[:3, :3] @ person.head + person.transform[:3, 3]
    expected = np.diag([1, -1, -1]) @ (eye[:3, :3] @ anns + eye[:3, 3])
    assert np.abs(np.array(place) - expected).max() < 0.02, (place, expected, jobs[-1].room)


def test_three_pages_join_and_leave(member: Any, lab: Served) -> None:
    ann, bob, cy = (member(name) for name in ("Ann", "Bob", "Cy"))
    for page, others in ((ann, ["Bob", "Cy"]), (bob, ["Ann", "Cy"]), (cy, ["Ann", "Bob"])):
        page.meanwhile(lambda page=page, others=others: names(page) == others, PATIENCE_S)
    click(cy, "talk-join")
    for page, others in ((ann, ["Bob"]), (bob, ["Ann"]), (cy, [])):
        page.meanwhile(lambda page=page, others=others: names(page) == others, PATIENCE_S)
    assert lab.stats()["talk"]["people"] == 2
    click(cy, "talk-join", "talk-no")  # the answer of before does not count
    assert cy.js("document.querySelector('#talk-join').ariaPressed") == "false"


def test_who_is_back_talks_again_and_pushes_to_talk(member: Any, lab: Served) -> None:
    ann, bob = member("Ann"), member("Bob")
    hears(bob)
    cut_off(lab)  # Ann's
    ann.until("opened() === 2", PATIENCE_S)
    bob.until("peers.length === 2", PATIENCE_S)
    hears(bob)
    click(ann, "talk-push")
    silent(bob)
    assert "muted" in ann.js("document.querySelector('#talk-state').textContent")
    ann.js("document.activeElement.blur()")
    ann.page.keyboard.down("Space")
    hears(bob)
    ann.page.keyboard.up("Space")
    silent(bob)
    hold = "(type) => document.getElementById('talk-hold').dispatchEvent(new Event(type))"
    ann.js(hold, "pointerdown")
    hears(bob)
    ann.js(hold, "pointerup")
    silent(bob)
    bob.js("entered('hall')")  # agreed to was the lab
    ann.meanwhile(lambda: people(ann) == [], PATIENCE_S)
    assert bob.js("document.querySelector('#talk-join').ariaPressed") == "false"
    bob.js("entered('')")
    assert bob.js("document.querySelector('#talk').hidden && document.querySelector('#talk-join').hidden")


def test_who_has_no_microphone_hears_the_others(member: Any, chromium: Any) -> None:
    member("Ann")
    bob = member("Bob", browser=chromium)  # which has none, and allows none
    assert bob.js("document.querySelector('#talk-state').textContent").startswith("They do not hear you: ")
    hears(bob)


def test_without_a_path_a_sentence_says_so(member: Any) -> None:
    ann = member("Ann", script="window.forced = { iceTransportPolicy: 'relay' };")  # and there is no relay
    bob = member("Bob")
    for page in (ann, bob):
        page.until(
            "document.querySelector('#talk-people').textContent.includes('No path between your browsers')", PATIENCE_S
        )


MAIN = """
import { Peer } from '/vr/talk/peer.js';
const options = { offers: false, track: null, configuration: {}, send() {}, changed() {} };
const alone = (context) => new Peer({ name: '' }, { ...options, context });
window.levels = async (...at) => {
  const context = new OfflineAudioContext(2, 48000, 48000);
  const peer = alone(context);
  const tone = new OscillatorNode(context, { type: 'sawtooth', frequency: 200 });
  tone.connect(peer.meter);
  tone.start();
  peer.place(at);
  const sound = await Promise.race([context.startRendering(), new Promise((done) => setTimeout(done, 20_000))]);
  peer.close();
  return sound && [0, 1].map((side) => {
    const settled = sound.getChannelData(side).subarray(24000);
    return 20 * Math.log10(Math.sqrt(settled.reduce((sum, v) => sum + v * v, 0) / settled.length));
  });
};
window.survives = async (...texts) => {
  const peer = alone(new OfflineAudioContext(2, 1, 48000));
  for (const text of texts) peer.receive(text);
  await new Promise((done) => setTimeout(done, 500));
  return peer.path;
};
"""


@pytest.fixture(scope="module")
def voices(speaking: Any) -> Iterator[Any]:
    """A page with the functions of MAIN."""
    with flat_page(speaking, MAIN, "window.levels") as page:
        yield page


def test_a_voice_falls_by_6_db_for_twice_as_far_and_comes_from_its_side(voices: Any) -> None:
    def levels(*at: float) -> tuple[float, float]:
        """Return the levels at the left and the right ear, dB; now and then Chromium does not end a rendering."""
        left, right = next(filter(None, (voices.evaluate("(at) => levels(...at)", at) for _ in range(5))))
        return left, right

    near, far, farther = (np.mean(levels(0, 0, -metres)) for metres in (1, 2, 4))
    assert near - far == pytest.approx(6, abs=0.2) and near - farther == pytest.approx(12, abs=0.3)
    for side in (1, -1):
        left, right = levels(side * 1, 0, 0)
        assert side * (right - left) > 3


def test_signals_that_are_none_do_no_harm(voices: Any) -> None:
    garbage = ["", "null", "{}", "[1, null]", '[{"sdp": "v=0"}]', '[{"sdp": {}}]', '[{"candidate": {"candidate": 7}}]']
    assert voices.evaluate("(texts) => survives(...texts)", garbage) == "looking"
