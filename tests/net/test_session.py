"""The session with a fake clock: mailbox, window, order, budgets, time-outs."""

from __future__ import annotations

import json

import pytest

from glsplat.net.messages import Decoder
from glsplat.net.session import Close, Session, SessionConfig, Warn

EYE = {"viewmat": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 2, 0, 0, 0, 1], "K": [50, 50, 32, 32]}


def native(frame_id, ack=None, **more):
    message = {"v": 1, "frame_id": frame_id, "eyes": [EYE, EYE], "size": [64, 64], **more}
    return json.dumps(message if ack is None else message | {"ack": ack})


def camera(eye):
    return {"pos_x": 0, "pos_y": 1, "pos_z": 2, "rot_x": 0, "rot_y": 0, "rot_z": 0, "rot_w": 1, "eye": eye}


def session(**config):
    return Session(Decoder(), SessionConfig(**config), now=0.0)


def take(s, now=0.0):
    taken = s.next_request(now)
    return None if taken is None else taken[0]


def deliver(s, request):
    s.sending(request)
    s.sent(request, 100)


def test_only_the_newest_waiting_request_is_kept():
    s = session()
    for i in range(1, 6):
        assert s.receive(native(i, 0), i * 0.01).frame_id == i
    request, waited = s.next_request(0.06)
    assert request.frame_id == 5 and waited == pytest.approx(0.01)
    assert s.counts.dropped == 4 and take(s) is None


@pytest.mark.parametrize("window", [1, 2, 3])
def test_at_most_window_pictures_are_unacknowledged(window):
    s = session(window=window)
    taken = 0
    for i in range(1, 10):
        s.receive(native(i, 0), i * 0.01)
        request = take(s)
        if request is not None:
            taken += 1
            deliver(s, request)
    assert taken == window
    s.receive(native(10, 1), 0.2)
    assert take(s).frame_id == 10 and not s.ready()


def test_pictures_under_way_count_against_the_window_once():
    s = session(window=2)
    s.receive(native(1, 0), 0)
    first = take(s)
    s.receive(native(2, 0), 0)
    second = take(s)
    s.receive(native(3, 0), 0)
    assert not s.ready()
    s.sending(first)  # unacknowledged and still under way: one picture, not two
    assert s.status()["under_way"] == 2 and not s.ready()
    s.sent(first, 1)
    assert not s.ready()
    s.receive('{"v": 1, "ack": 1}', 0)
    assert s.ready() and take(s).frame_id == 3
    deliver(s, second)


def test_clients_that_never_acknowledge_are_not_held_back():
    s = session(window=1)
    for i in range(1, 5):
        s.receive(native(i), 0)
        deliver(s, take(s))
    assert s.status()["unacknowledged"] == 0


def test_a_client_that_stops_acknowledging_goes_on():
    s = session(window=1)
    s.receive(native(1, 0), 0)
    deliver(s, take(s))
    s.receive(native(2), 0)
    assert take(s).frame_id == 2


def test_an_acknowledgement_of_something_never_sent_is_malformed():
    s = session()
    outcome = s.receive(native(1, 7), 0)
    assert isinstance(outcome, Warn) and json.loads(outcome.text)["error"]["code"] == "bad_ack"
    assert take(s) is None


def test_repeated_and_older_requests_are_never_drawn():
    s = session()
    drawn = []
    for i in (3, 3, 2, 4, 1, 4, 5):
        assert not isinstance(s.receive(native(i, 0), 0), Warn | Close)
        request = take(s)
        if request:
            drawn.append(request.frame_id)
            s.failed(request, "render", "no")
    assert drawn == [3, 4, 5] and s.counts.stale == 4


def test_a_failed_picture_frees_the_window():
    s = session(window=1)
    s.receive(native(1, 0), 0)
    text = s.failed(take(s), "render", "the picture could not be drawn")
    assert json.loads(text)["error"] == {
        "code": "render",
        "message": "the picture could not be drawn",
        "frame_id": 1,
    }
    s.receive(native(2, 0), 0)
    assert take(s).frame_id == 2


def test_malformed_messages_cost_themselves_then_the_connection():
    s = session(errors=3, forgive=0.5)
    outcomes = [s.receive("{", 0.0) for _ in range(4)]
    assert [type(o) for o in outcomes] == [Warn] * 3 + [Close]
    assert outcomes[-1].code == 1008
    assert json.loads(outcomes[0].text)["error"]["code"] == "bad_json"


def test_malformed_messages_are_forgiven_over_time():
    s = session(errors=3, forgive=0.5, rate=1e6, burst=1e6)
    outcomes = [s.receive("{", t * 2.0) for t in range(50)]
    assert all(isinstance(o, Warn) for o in outcomes)
    assert s.counts.malformed == 50


def test_messages_above_the_rate_are_not_read():
    s = session(rate=100, burst=50, flood=10_000)
    for i in range(1, 1001):  # 1000 messages in one second
        s.receive(native(i, 0), i / 1000)
    assert s.counts.accepted == pytest.approx(150, abs=2)
    assert s.counts.limited == 1000 - s.counts.accepted
    assert s.counts.malformed == 0


def test_the_rate_notice_comes_once_a_second():
    s = session(rate=10, burst=5, flood=10_000)
    notices = [t / 100 for t in range(500) if isinstance(s.receive(native(t, 0), t / 100), Warn)]
    assert 4 <= len(notices) <= 5


def test_a_flood_ends_the_connection():
    s = session(rate=100, burst=10, flood=200)
    outcomes = [s.receive(native(i, 0), 0.5) for i in range(400)]
    assert any(isinstance(o, Close) and o.code == 1008 for o in outcomes)


def test_a_clock_that_stands_still_or_jumps_back_breaks_nothing():
    s = session(rate=100, burst=50)
    for i, now in enumerate((1.0, 1.0, 0.5, 0.5, 2.0)):
        assert s.receive(native(i + 1, 0), now).frame_id == i + 1
    assert s.counts.accepted == 5


def test_time_outs():
    s = session(handshake=10, idle=60)
    assert s.expired(9.9) is None
    assert s.expired(10.0).code == 1008
    s.receive("{", 5.0)  # nothing valid yet: still the handshake's time
    assert s.expired(10.0) is not None
    s.receive(native(1, 0), 6.0)
    assert s.expires() == 66.0 and s.expired(65.9) is None
    s.receive('{"v":1,"ack":0}', 60.0)
    assert s.expired(119.0) is None and s.expired(120.0).reason == "idle"


def test_the_eyes_of_the_oldest_form_do_not_push_each_other_out():
    s = session(window=2)
    for eye in ("left", "right", "right"):
        s.receive(json.dumps({"camera": camera(eye), "smplx": {}}), 0)
    first, second = take(s), take(s)
    assert (first.eyes, second.eyes) == ((0,), (1,))
    assert s.counts.dropped == 1 and take(s) is None


def test_there_is_no_number_after_the_highest():
    s = session()
    assert s.receive(native(2**32 - 1), 0).frame_id == 2**32 - 1
    deliver(s, take(s))
    told = s.receive(json.dumps({"cameras": [camera("left")], "smplx": {}}), 0)  # would be counted on from there
    assert isinstance(told, Warn) and "connect again" in told.text and take(s) is None


def test_the_tracking_of_dropped_requests_still_reaches_the_solver():
    s = session()
    for i in range(1, 101):
        head = [i / 100, 1.6, 0, 0, 0, 0, 1]
        message = {"v": 1, "frame_id": i, "ack": 0, "t": i * 10.0, "tracking": {"head": head}}
        request = s.receive(json.dumps(message), i * 0.01)
        assert request.t == i * 10.0 and request.tracking.t == i / 100 and request.tracking.head[0] == i / 100
    assert take(s).frame_id == 100
    assert s.receive(json.dumps({"v": 1, "ack": 0}), 2) is None
    old = {"v": 1, "frame_id": 99, "ack": 0, "t": 2000.0, "tracking": {"head": head}}
    assert s.receive(json.dumps(old), 2) is None  # too old: neither drawn nor solved


def test_a_request_that_is_kept_can_be_taken_after_newer_ones_came():
    s = Session(Decoder())
    s.receive(native(1), 0.0)
    s.keep()
    for i in (2, 3):
        s.receive(native(i), i * 0.1)
    assert (s.kept.frame_id, s.newest.frame_id, s.counts.dropped, s.status()["waiting"]) == (1, 3, 1, 2)
    request, waited = s.next_request(0.5, kept=True)
    assert request.frame_id == 1 and waited == 0.5 and s.kept is None and s.ready()
    assert s.next_request(0.5)[0].frame_id == 3 and s.newest is None and not s.ready()


def test_the_newest_request_takes_the_place_of_the_one_kept():
    s = Session(Decoder())
    s.receive(native(1), 0.0)
    s.keep()
    s.receive(native(2), 0.1)
    assert s.next_request(0.2)[0].frame_id == 2 and s.kept is None and not s.ready() and s.counts.dropped == 1
    s.receive(native(3), 0.3)
    s.keep()
    assert s.status()["waiting"] == 1
    assert s.next_request(0.4)[0].frame_id == 3 and s.kept is None and s.newest is None and s.counts.dropped == 1
