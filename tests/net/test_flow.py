"""The client's half without sockets: what is under way, what is answered, when to ask, when to connect again."""

from __future__ import annotations

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glsplat.errors import ProtocolError
from glsplat.net.flow import POLICIES, Backoff, FlowControl, server_error
from glsplat.net.messages import Ack, Decoder, Request
from glsplat.net.session import Session, SessionConfig
from tests.net.wire import native


def asked(*numbers: int) -> FlowControl:
    flow = FlowControl()
    for number in numbers:
        flow.request(number, number / 10)
    return flow


def test_a_picture_answers_its_request_and_all_before():
    flow = asked(1, 2, 3, 4)
    answer = flow.arrived(3)
    assert (answer.frame_id, answer.requested, answer.replaced) == (3, 0.3, (1, 2))
    assert flow.waiting and flow.unanswered == 1
    assert flow.arrived(3).frame_id is None and flow.arrived(2).frame_id is None and flow.arrived(9).frame_id is None
    assert flow.arrived(4).replaced == () and not flow.waiting


def test_acknowledge_at_once_only_what_holds_others_back():
    flow = asked(1, 2)
    flow.arrived(1)
    assert flow.take(1) and Decoder().decode(flow.acknowledgement(1.0)) == Ack(1)
    flow.arrived(2)
    assert not flow.take(2) and flow.taken == 2
    flow.take(1)  # taken late: an acknowledgement never goes back
    assert flow.taken == 2


def test_frame_ids_grow():
    with pytest.raises(ProtocolError, match="2 does not follow 2"):
        asked(1, 2, 2)


def test_what_was_not_sent_is_not_waited_for():
    flow = asked(1)
    flow.unsent(1)
    assert not flow.waiting and flow.arrived(1).frame_id is None


def test_a_picture_whose_waiter_left_is_for_nobody():
    flow = asked(1, 2)
    flow.leave(1)
    flow.leave(7)  # not under way
    assert not flow.arrived(1).wanted and flow.arrived(2).wanted


@pytest.mark.parametrize(("code", "replaced"), [("bad_pose", ()), ("render", (1, 2)), ("encode", (1, 2))])
def test_an_error_answers_one_request_or_also_those_before(code, replaced):
    """A picture that was taken in hand and failed had replaced the older ones; a message that was refused had not."""
    flow = asked(1, 2, 3)
    answer = flow.failed(ProtocolError("no", code, 3))
    assert (answer.frame_id, answer.replaced, flow.refused) == (3, replaced, 3)
    assert flow.unanswered == 2 - len(replaced)


def test_an_error_without_a_number_is_about_who_waits():
    flow = asked(1, 2)
    assert flow.failed(ProtocolError("too many messages", "rate")).frame_id is None
    assert flow.unanswered == 2 and flow.last_error == "too many messages"
    assert flow.failed(ProtocolError("who?", "bad_json"), waited_for=2).frame_id == 2
    assert flow.unanswered == 1


def test_when_to_ask():
    flow = asked(1, 2)
    assert [flow.may_request(policy, 2, 0) for policy in POLICIES] == [True, False, False]
    assert flow.may_request("fifo", 3, 0)
    flow.arrived(1)
    assert [flow.may_request(policy, 2, 1) for policy in POLICIES] == [True, False, True]
    flow.arrived(2)
    assert [flow.may_request(policy, 2, 1) for policy in POLICIES] == [True, False, True]  # it is not decoded yet
    assert all(flow.may_request(policy, 2, 2) for policy in POLICIES)
    flow.request(3, 0.3)
    flow.failed(ProtocolError("no", "render", 3))
    assert all(flow.may_request(policy, 2, 2) for policy in POLICIES)  # nothing is there to be decoded


def test_a_request_carries_its_subject():
    flow = FlowControl()
    for number in range(1, 5):
        flow.request(number, 0.0, f"wish {number}")
    flow.arrived(2)
    flow.arrived(3)  # before somebody took 2
    assert (flow.about(2), flow.about(3), flow.about(9)) == ("wish 2", "wish 3", None)
    flow.take(3)
    assert (flow.about(2), flow.about(3), flow.about(4)) == (None, "wish 3", "wish 4")
    for number in range(5, 2000):
        flow.request(number, 0.0, "x")
    assert len(flow._subjects) <= 256


def test_ever_longer_until_it_works():
    backoff = Backoff()
    assert [backoff.pause() for _ in range(7)] == [0.5, 1, 2, 4, 8, 8, 8]
    backoff.connected()
    assert backoff.pause() == 0.5


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"error": 7}', '{"error": {"code": "x"}}', "null"])
def test_a_text_that_is_no_error(text):
    assert server_error(text).code == "bad_reply"


def test_the_servers_error():
    error = server_error('{"error": {"code": "bad_pose", "message": "no", "frame_id": 7}}')
    assert (error.code, str(error), error.frame_id) == ("bad_pose", "no", 7)


@settings(max_examples=150, deadline=None)
@given(st.lists(st.sampled_from(["ask", "draw", "deliver", "fail"]), max_size=60), st.sampled_from(POLICIES))
def test_with_the_servers_half_nothing_gets_stuck(steps, policy):
    """Both halves, any order of events: windows hold, acknowledgements are legal, the newest is answered."""
    flow, session, now = FlowControl(), Session(Decoder(), SessionConfig(window=2)), 0.0
    drawing, wire, decoded = [], [], 0

    def step(kind):
        nonlocal decoded
        if kind == "ask" and flow.may_request(policy, 2, decoded):
            flow.request(flow.newest + 1, now)
            text = json.loads(native(flow.newest)) | {"ack": flow.taken}
            assert isinstance(session.receive(json.dumps(text), now), Request)
        elif kind == "draw" and session.ready():
            drawing.append(session.next_request(now)[0])
        elif kind in ("deliver", "fail") and drawing:
            request = drawing.pop(0)
            if kind == "fail":
                wire.append(server_error(session.failed(request, "render", "no")))
            else:
                session.sending(request)
                session.sent(request, 1)
                wire.append(request.frame_id)
        while wire and kind != "ask":
            message = wire.pop(0)
            if isinstance(message, ProtocolError):
                assert flow.failed(message).frame_id == message.frame_id
            else:
                assert flow.arrived(message).frame_id == message
                decoded = message
                if flow.take(message):
                    assert session.receive(flow.acknowledgement(now), now) is None
        assert session.status()["under_way"] <= 2

    for kind in steps:
        now += 0.01
        step(kind)
    for _ in range(8):
        for kind in ("draw", "deliver"):
            step(kind)
    assert not flow.waiting and not session.ready() and flow.unanswered == 0
    assert flow.may_request(policy, 2, decoded)
