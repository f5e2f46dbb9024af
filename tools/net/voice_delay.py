"""Measure the delay from a sound to the picture of its mouth, in Chromium with a microphone that plays a file.

    python -m tools.net.voice_delay                          # pictures of what `glsplat serve` draws
    python -m tools.net.voice_delay --here                   # drawn by the page from poses
    python -m tools.net.voice_delay -- --config exact.toml   # the server's options

The microphone plays "aa" for half a second, then silence for a second, in turns. An audio worklet of its own notes
when each sound begins. The script looks for a jaw that opens in the requests, and takes the page's own numbers for the
picture of that request, or of a newer one that was drawn instead. If the page draws by itself, it takes the first frame
with a jaw that opens.

Printed are the whole delay, in ms and in periods of a picture, and its parts. A delay of many periods is a queue.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.extras.speech.sound import Sound
from tests.extras.speech.sounds import vowels, wav_bytes
from tools.docs.chromium import launched, serving

MAX_DELAY_MS = 700.0  # from a sound to a request with an open jaw; later: the sound was missed

WATCH = """
(() => {
  // [ms] of sounds; [ms, frame_id] of requests with a jaw that opens, of pictures decoded and on the screen;
  // [frame_id, ms, ms it was sent, its server's times] of replies; [ms] of frames drawn here with a jaw that opens
  const seen = (window.delays = { sounds: [], sent: [], came: [], decoded: [], shown: [], drawn: [] });
  const ask = navigator.mediaDevices.getUserMedia.bind(navigator.mediaDevices);
  const code = `registerProcessor('loud', class extends AudioWorkletProcessor {
    process([[samples]]) {
      const loud = samples && samples.some((v) => Math.abs(v) > 0.02);
      if (loud && currentTime - (this.last ?? -9) > 0.4) this.port.postMessage(Date.now());
      if (loud) this.last = currentTime;
      return true;
    }
  });`;
  navigator.mediaDevices.getUserMedia = async (wanted) => {
    const stream = await ask({ audio: true });
    const context = new AudioContext({ latencyHint: 'interactive' });
    await context.audioWorklet.addModule(URL.createObjectURL(new Blob([code], { type: 'text/javascript' })));
    const node = new AudioWorkletNode(context, 'loud', { numberOfOutputs: 0 });
    node.port.onmessage = ({ data }) => seen.sounds.push(data - performance.timeOrigin);
    context.createMediaStreamSource(stream).connect(node);
    return stream;
  };
  const opening = (then) => {
    let open = false;
    return (jaw) => {
      if (jaw > 0.06 && !open) then();
      open = jaw > 0.03 && (open || jaw > 0.06);
    };
  };
  const at = new Map(); // when a request was sent, by its number
  let newest = 0;
  const asks = opening(() => seen.sent.push([performance.now(), newest]));
  const draws = opening(() => seen.drawn.push([performance.now(), 0]));
  const reading = import('/vr/stream/reply.js');
  const decoding = []; // numbers of the replies that are with the decoder
  window.Worker = class extends Worker { // the page's socket is in one (stream/socket.js), its decoder in another
    constructor(...what) {
      super(...what);
      this.addEventListener('message', ({ data }) => {
        const now = performance.now();
        if (data.pictures && decoding.length) seen.decoded.push([now, decoding.shift()]);
        if (!(data.message instanceof ArrayBuffer) || new DataView(data.message).getUint8(8) === 0) return;
        const copy = data.message.slice(0); // the page gives it away
        reading.then(({ parseReply }) => {
          const { id, info } = parseReply(copy);
          seen.came.push([id, now, at.get(id), info.times]);
        });
      });
    }

    postMessage(told, ...rest) {
      if (told?.buffer && told.eyes) decoding.push(new DataView(told.buffer).getUint32(4, true));
      const found = told?.text && JSON.parse(told.text);
      if (found?.frame_id) {
        newest = found.frame_id;
        at.set(newest, performance.now());
        asks((found.pose ?? found.tracking)?.expression?.jawOpen ?? 0);
      }
      super.postMessage(told, ...rest);
    }
  };
  const look = () => {
    const { shownId = 0, drawn = {} } = window.glsplat?.stats() ?? {};
    if (shownId !== seen.shown.at(-1)?.[1]) seen.shown.push([performance.now(), shownId]);
    if (drawn.jaw !== undefined) draws(drawn.jaw);
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
})();
"""


def watched(address: str, here: bool, seconds: float, size: int) -> dict[str, Any]:
    """Return the events of the page (``WATCH``), and its figures."""
    from playwright.sync_api import sync_playwright

    rate = 48000
    said = np.concatenate([np.zeros(rate // 2), vowels(0.5, rate, each=9), np.zeros(rate // 2)]).astype(np.float32)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        file = Path(folder) / "said.wav"
        file.write_bytes(wav_bytes(Sound(said, rate)))
        browser = launched(
            play,
            "--use-fake-device-for-media-stream",
            "--use-fake-ui-for-media-stream",
            f"--use-file-for-fake-audio-capture={file}",
            "--autoplay-policy=no-user-gesture-required",
        )
        context = browser.new_context(viewport={"width": size, "height": size}, bypass_csp=True)
        context.add_init_script(WATCH)
        drawn = "here" if here else "server"
        kept = f'localStorage.setItem(\'glsplat.settings\', \'{{"size": 512, "drawn": "{drawn}"}}\')'
        context.add_init_script(kept)
        page = context.new_page()
        page.goto(address)
        page.wait_for_function("window.glsplat && glsplat.stats().shownId > 3", timeout=120_000)
        page.evaluate("document.querySelector('#voice-talk').click()")  # it is behind the drawer
        before = page.evaluate("glsplat.stats().shown")
        page.wait_for_timeout(1000 * seconds)
        found: dict[str, Any] = page.evaluate("delays")
        found["stats"] = page.evaluate("glsplat.stats()")
        found["rate"] = (found["stats"]["shown"] - before) / seconds
        browser.close()
    return found


PARTS = (
    "heard, and sent",
    "another picture is drawn: a newer request took its place",
    "waits at the server",
    "drawn",
    "encoded",
    "on the way, both",
    "decoded",
    "shown with the next frame of the page",
)


HERE = ("heard, and sent", "drawn here, and shown with the next frame of the page")


def measured(found: dict[str, Any]) -> tuple[list[float], list[list[float]]]:
    """Return the delay of each sound's picture in ms, and its parts where all are known."""
    came = {number: (arrived, asked, times) for number, arrived, asked, times in found["came"]}
    decoded = {number: t for t, number in found["decoded"]}
    local = found["stats"]["drawn"]["by"] == "here" and found["drawn"]
    behind, parts = [], []
    for begin in found["sounds"][1:]:  # the first may have begun before anything listened
        opens, frame = next(((t, frame) for t, frame in found["sent"] if t >= begin), (np.inf, 0))
        if local:
            shows = next((t for t, _ in found["drawn"] if t >= begin), np.inf)
            if shows - begin < MAX_DELAY_MS:
                behind.append(shows - begin)
                parts.append([opens - begin, shows - opens])
            continue
        shows, number = next(((t, shown) for t, shown in found["shown"] if shown >= frame), (None, 0))
        if opens - begin > MAX_DELAY_MS or shows is None:
            continue
        behind.append(shows - begin)
        if number in came and number in decoded:
            arrived, asked, times = came[number]
            server = [times[name] for name in ("wait", "render", "encode")]
            way = arrived - asked - sum(server)
            ready = decoded[number]
            parts.append([opens - begin, asked - opens, *server, way, ready - arrived, shows - ready])
    return behind, parts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--here", action="store_true", help="let the page draw")
    parser.add_argument("--seconds", type=float, default=40)
    parser.add_argument("--size", type=int, default=512, help="of the window, pixels")
    parser.add_argument("options", nargs="*", help="of `glsplat serve`, behind --")
    args = parser.parse_args()
    with serving(args.options) as address:
        found = watched(address, args.here, args.seconds, args.size)
    behind, parts = measured(found)
    if not behind:
        raise SystemExit("no sound's picture was seen")
    by, median = found["stats"]["drawn"]["by"], statistics.median(behind)
    frames = found["stats"]["frameRate"]
    print(f"{len(behind)} sounds, ms behind at 10, 50, 90 %: {np.percentile(behind, [10, 50, 90]).round().tolist()}")
    print(f"drawn by {by}, {found['rate']:.1f} pictures and {frames:.1f} frames of the page a second")
    for name, values in zip(HERE if by == "here" else PARTS, zip(*parts, strict=True), strict=False):
        print(f"{statistics.median(values):7.0f} ms  {name}")
    print(f"median: {median:.0f} ms, {median * found['rate'] / 1000:.2f} pictures")


if __name__ == "__main__":
    main()
