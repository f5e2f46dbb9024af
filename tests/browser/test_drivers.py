"""The page's sources of motion, its recorder and its calibration, beside their twins in Python."""

from __future__ import annotations

import json
from importlib import resources

import numpy as np
import pytest

from glsplat.data import default_avatar
from glsplat.errors import FormatError, PoseError
from glsplat.net.messages import Decoder
from glsplat.tracking.calibration import calibrate
from glsplat.tracking.recording import embedded_recording, replay
from glsplat.tracking.sample import TRACKERS, Sample
from tests.browser.flat_page import flat_page

MAIN = """
import * as calibration from '/vr/track/calibration.js';
import * as drivers from '/vr/track/drivers.js';
import * as recorder from '/vr/track/recorder.js';
Object.assign(window, { ...drivers, ...recorder, ...calibration });
"""
CALIBRATE = """([samples, step, height]) => {
  const calibration = new Calibration(null);
  calibration.begin(1000, { height });
  let now = 1000;
  for (const sample of samples) {
    const answer = calibration.add(sample, now);
    if (!('progress' in answer)) return answer;
    now += step;
  }
  return calibration.add(null, now);
}"""
HEAD = [0.01, 1.6, 0.02, 0.0, 0.0, 0.0, 1.0]


@pytest.fixture(scope="module")
def page(chromium):
    with flat_page(chromium, MAIN, "window.Calibration") as page:
        yield page


def data(name: str) -> str:
    return resources.files("glsplat.data").joinpath(name).read_text(encoding="utf-8")


def test_a_motion_takes_keys_that_some_frames_lack_and_refuses_what_is_none(page):
    half = "([frames, t]) => new Motion({ fps: 1, frames }).at(t).pose"
    pose = page.evaluate(half, [[{"root_pose": [0, 3.0, 0]}, {"root_pose": [0, -3.0, 0]}], 0.5])
    assert abs(abs(pose["root_pose"][0][1]) - np.pi) < 1e-9  # the short way, over pi
    pose = page.evaluate(half, [[{"jaw_pose": [0.4, 0, 0]}, {"trans": [0, 0, 1]}], 0.25])
    assert pose["jaw_pose"][0] == pytest.approx([0.3, 0, 0]) and pose["trans"] == pytest.approx([0, 0, 0.25])
    for wrong in ({"fps": 0, "frames": [{}]}, {"fps": 30, "frames": []}, {"fps": 30}):
        said = page.evaluate("(m) => { try { new Motion(m); } catch (e) { return e.message; } }", wrong)
        assert "frame rate above zero" in said


def test_the_embedded_recording_plays_on_one_growing_clock(page):
    samples = embedded_recording()
    rounds = page.evaluate(
        """(text) => { const r = new Recording(parseRecording(text)); const out = [];
          for (let i = 0; i < 2000; i++) out.push(r.at(i / 100)); return [r.frames, r.duration, out]; }""",
        data("recording.jsonl"),
    )
    frames, duration, shown = rounds
    assert frames == len(samples) and duration == pytest.approx(len(samples) / 72, abs=1e-4)
    times = np.array([entry["t"] for entry in shown])
    clock = np.arange(2000) * 10.0
    assert (np.diff(times) >= 0).all()
    assert (clock - times >= -1e-6).all() and (clock - times < 1000 / 72 + 0.01).all()
    decoder = Decoder()
    for i in (0, 100, 796, 797, 1999):
        expected = samples[np.searchsorted([s.t for s in samples], (clock[i] / 1000) % duration, "right") - 1]
        assert Sample.from_json(shown[i]["tracking"]) == Sample.from_json(expected.to_json(), t=0.0)
        request = decoder.decode(json.dumps({"v": 1, "frame_id": i + 1, **shown[i]}))
        assert request.tracking is not None and request.t == shown[i]["t"]


def line(**keys: object) -> str:
    return json.dumps({"t": 0.5, "head": HEAD, **keys})


HAND = [[0.1 * i, 1.0, 0.2] for i in range(25)]
READ = [
    line(),
    line(left=None, right=HEAD, left_curl=0.25, right_curl=None),
    line(left_joints=HAND, right_joints=[v for joint in HAND for v in joint]),
    line(left_joints=[[*joint, 0, 0, 0, 1] for joint in HAND]),
    line(left_joints=[[9, 9, 9], *HAND]),
    line(waist=HEAD, right_foot=None, body={"hips": HEAD, "left-foot-ball": HEAD[:3], "chest": 5}, unknown={"a": [1]}),
    line(waist=[float("nan"), *HEAD[1:]], body={"hips": None}),
    line(expression={"jawOpen": 0.5, "cheekPuff": None, "odd": -2}, leftEye=[0, 0.1, -1], rightEye=None),
    line(expression=[0.25] * 52, rightEye=[0.5, 0, -1]),
    json.dumps({"t": 3, "left_grip": HEAD}),
    "\ufeff" + line() + "\r\n\n",
    line(left=[float("-inf"), *HEAD[1:]]),
    line().replace("0.01", "1e999"),
]
REFUSED = [
    "{", "[]", "null", line() + line(), line(t=None), line(t="0"), json.dumps({"head": HEAD}), json.dumps({"t": 1}),
    line(head=HEAD[:6]), line(head="abcdefg"), line(head=[*HEAD[:6], True]), line(left_joints=HAND[:24]),
    line(left_joints=[[1, 2]] * 25), line(left_curl="fist"), line() + " " * (1 << 20), line(waist=[1, 2]),
    line(body="hips"), line(body={"hips": [1, 2]}), line(expression="smile"), line(expression=[1.0] * 51),
    line(leftEye=[1, 2]), line(expression={f"{i}": 1 for i in range(257)}), line(body={f"{i}": 1 for i in range(257)}),
]  # fmt: skip


def parsed(page, text: str):
    return page.evaluate("(text) => { try { return parseRecording(text); } catch (e) { return e.message; } }", text)


def test_what_the_program_reads_the_page_reads_and_what_it_refuses_too(page, tmp_path):
    path = tmp_path / "recording.jsonl"
    for text in READ:
        path.write_text(text, encoding="utf-8")
        expected, found = list(replay(path)), parsed(page, text)
        assert len(found) == len(expected) > 0
        for sample, twin in zip(found, expected, strict=True):
            mine = Sample.from_json(sample)
            assert mine.t == twin.t and (mine.left_curl, mine.right_curl) == (twin.left_curl, twin.right_curl)
            body = None if twin.body is None else {name: joint[:3] for name, joint in twin.body.items()}
            assert mine.body == body and mine.expression == twin.expression
            assert (mine.left_eye, mine.right_eye) == (twin.left_eye, twin.right_eye)
            for key in ("head", "left", "right", "left_joints", "right_joints", *TRACKERS):
                value = getattr(twin, key)
                tracked = value is not None and np.isfinite(np.hstack(value)).all()
                assert getattr(mine, key) == (value if tracked else None)
    for text in REFUSED:
        path.write_text(f"{line()}\n\n{text}\n", encoding="utf-8")
        with pytest.raises(FormatError, match="line 3"):
            list(replay(path))
        said = parsed(page, path.read_text(encoding="utf-8"))
        assert isinstance(said, str) and said.startswith("Line 3 of the recording: ") and "\n" not in said, text
    assert parsed(page, "") == parsed(page, "\n\n") == "The recording has no sample with a time."
    times = "\n".join(line(t=t) for t in (5.0, 5.1, 5.05, 5.1, 5.2))  # what does not grow is passed over
    call = "(text) => { const r = new Recording(parseRecording(text)); return [r.frames, r.at(0.15).t]; }"
    assert page.evaluate(call, times) == [3, pytest.approx(100)]


def test_a_recording_made_in_the_page_is_read_by_the_program(page, tmp_path):
    hand = [[0.1234567891 * i, 1.0, -0.2] for i in range(25)]
    text, count, seconds, took = page.evaluate(
        """async ([head, hand]) => {
          const recorder = new Recorder();
          recorder.add({ head }, 1);
          recorder.start();
          const took = [
            recorder.add({ head, left: null, left_joints: hand, left_curl: 0.1234567 }, 5000, { body: { hips: head } }),
            recorder.add({ head: [NaN, 0, 0, 0, 0, 0, 1], right: head }, 5011.1111),
            recorder.add({ head }, 5011.1111),
            recorder.add({ head }, NaN),
            recorder.add({ right_grip: new Float32Array(head), expression: { jawOpen: 0.3 } }, 5500),
          ];
          const blob = recorder.stop();
          took.push(recorder.add({ head }, 6000));
          return [await blob.text(), recorder.count, recorder.seconds, took];
        }""",
        [HEAD, hand],
    )
    assert took == [True, True, False, False, True, False]
    path = tmp_path / "recording.jsonl"
    path.write_text(text)
    samples = list(replay(path))
    assert [s.t for s in samples] == [0.0, 0.011111, 0.5] and count == 3 and seconds == pytest.approx(0.5)
    assert samples[0].head == tuple(HEAD) and samples[0].left is None and samples[0].left_curl == 0.123457
    assert np.abs(np.array(samples[0].left_joints) - hand).max() <= 5.1e-7
    assert samples[1].head is None and samples[1].right == tuple(HEAD) and samples[2].right is not None
    assert json.loads(text.splitlines()[0])["body"] == {"hips": HEAD}
    assert len(parsed(page, text)) == 3 and samples[2].expression == {"jawOpen": 0.3}


def test_a_full_recorder_stops_with_a_word_and_keeps_what_it_has(page):
    bytes_, word, size, count, more = page.evaluate(
        """async (head) => {
          const recorder = new Recorder(10000);
          recorder.start();
          let t = 0;
          while (recorder.add({ head }, (t += 8))) ;
          const word = recorder.word;
          const blob = recorder.stop();
          const lines = (await blob.text()).split('\\n').length - 1;
          recorder.start();
          return [blob.size, word, lines, recorder.count, recorder.add({ head }, 1)];
        }""",
        HEAD,
    )
    assert 9800 < bytes_ <= 10000 and f"{size} samples" in word and count == 0 and more is True


def standing(rng, seconds=2.2, eyes=1.6, span=None, wobble=0.004):
    samples = []
    for _ in range(int(seconds * 72)):
        place = np.array([0.3, eyes, -0.2]) + rng.normal(0, wobble, 3)
        sample = {"head": [*place.tolist(), 0.0, 0.0, 0.0, 1.0]}
        if span is not None:
            width = span * rng.uniform(0.97, 1)
            for side, x in (("left", -width / 2), ("right", width / 2)):
                sample[side] = [0.3 + x, 1.3, -0.2, 0.0, 0.0, 0.0, 1.0]
        samples.append(sample)
    return samples


def test_calibration_says_why_it_failed(page, rng):
    for samples, word in (
        (standing(rng, wobble=0.2), "moved"),
        (standing(rng)[:9], "lost tracking"),
        (standing(rng, eyes=0.4), "0.40 m"),
        (standing(rng, eyes=2.7), "2.70 m"),
    ):
        found = page.evaluate(CALIBRATE, [samples, 250.0 if len(samples) == 9 else 1000 / 72, None])
        assert word in found["error"]
        with pytest.raises(PoseError):
            calibrate([Sample.from_json(s, t=0) for s in samples], default_avatar().skeleton)


def test_a_kept_calibration_is_checked(page):
    found = page.evaluate("""() => {
      const kept = {}; const storage = { getItem: (k) => kept[k] ?? null, setItem: (k, v) => { kept[k] = v; } };
      const calibration = new Calibration(storage); const out = [calibration.load()];
      calibration.save({ height: 1.7, eyes: 1.59, span: null, floor: 0.01 }); out.push(calibration.load());
      for (const wrong of ['{', 'null', '[]', '{"height":"x"}', '{"height":1.7,"eyes":9,"span":null,"floor":0}']) {
        kept['glsplat.calibration'] = wrong; out.push(calibration.load());
      }
      const none = new Calibration(null);
      return [...out, none.load(), none.save({}), none.add(null, 1).error];
    }""")
    assert found[0] is None and found[1] == {"height": 1.7, "eyes": 1.59, "span": None, "floor": 0.01}
    assert found[2:8] == [None] * 6 and found[8] is False and "start one" in found[9]
