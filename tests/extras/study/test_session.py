"""The state machine alone: every way through, replayed from its log at every line, and what it refuses."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glsplat.errors import ProtocolError
from glsplat.extras.study.plan import steps_of
from glsplat.extras.study.session import Event, Session
from tests.extras.study.designs import planned


class Walk:
    """A session with its log, as a server keeps it, and a clock of its own."""

    def __init__(self, folder: Path, participant: int = 1) -> None:
        self.study, self.plan = planned(folder)
        self.steps = steps_of(self.study, self.plan, participant)
        self.session, self.log, self.t = Session(self.study, self.steps), list[Event](), 0.0

    def do(self, make: Callable[..., Sequence[Event]], *args: Any) -> list[Event]:
        events = list(make(*args, self.t))
        for event in events:
            self.session.apply(event)
        self.log += events
        return events

    def open(self) -> None:
        self.do(lambda t: self.session.open(t, {}))

    @property
    def name(self) -> str:
        assert self.session.step is not None
        return self.session.step.name

    def step(self) -> None:
        """Do what is to be done now."""
        session = self.session
        assert session.step is not None
        if session.step.kind == "consent":
            self.do(lambda t: session.consent(self.name, True, t))
        elif session.step.kind == "questionnaire":
            self.answer_all()
            self.do(session.submit, self.name)
        elif session.step.kind == "task" and session.state.phase == "instruction" and session.task.ready:  # type: ignore[union-attr]
            self.do(session.ready, self.name)
        else:
            self.t += session.left(self.t) or 0.0
            self.do(session.tick)

    def answer_all(self) -> None:
        assert self.session.step is not None
        for item in self.study.questionnaires[self.session.step.questionnaire].items:
            value = {"choice": "one", "text": "none"}.get(item.scale.kind, item.scale.low)
            self.t += 1
            self.do(self.session.answer, self.name, item.name, value, 1.0)

    def to(self, kind: str, phase: str = "") -> None:
        while not (self.session.step and self.session.step.kind == kind and self.session.state.phase.startswith(phase)):
            self.step()

    def again(self) -> Session:
        """As after a crash."""
        return replayed(self, self.log)


def replayed(walk: Walk, events: Sequence[Event]) -> Session:
    session = Session(walk.study, walk.steps)
    for event in events:
        session.replay(event)
    return session


@pytest.fixture
def walk(tmp_path: Path) -> Walk:
    return Walk(tmp_path)


def test_the_way_through(walk: Walk) -> None:
    names = [step.name for step in walk.steps]
    first, second = walk.plan.orders[0]
    assert names == [
        "001-consent", "002-nasa-tlx", f"003-{first}-wave", f"004-{first}-walk", f"005-{first}-movement", "006-rest",
        f"007-{second}-wave", f"008-{second}-walk", f"009-{second}-movement", "010-nasa-tlx", "011-own",
    ]  # fmt: skip
    walk.open()
    while walk.session.step:
        walk.step()
    assert walk.session.state.ended == "done"
    # both tasks twice (3 + 10 and 4 + 5 s), the rest, and a second an answer
    assert walk.t == pytest.approx(2 * (13 + 9) + 2 + 6 + 2 * 3 + 6 + 4)
    begun = [event for event in walk.log if event.kind == "begin"]
    assert [event.step for event in begun] == names
    slow = next(event for event in begun if event.values.get("condition") == "slow")
    assert slow.values["latency"] == 150 and slow.values["hands"] is False


def test_a_log_leads_back_at_every_line(walk: Walk) -> None:
    """Whatever was cut off at the end, the state is that of the lines that are left."""
    walk.open()
    states = []
    while walk.session.step:
        walk.step()
        states.append((len(walk.log), walk.session.state))
    for lines, state in states:
        assert replayed(walk, walk.log[:lines]).state == state


def test_without_consent_nothing_comes(walk: Walk, tmp_path: Path) -> None:
    agreed = Walk(tmp_path)
    agreed.do(lambda t: agreed.session.consent("001-consent", True, t))
    values, text = agreed.log[0].values, "You look at a body."  # it is kept with its text
    assert values["accepted"] is True and values["text"] == text
    assert values["sha256"] == hashlib.sha256(text.encode()).hexdigest()
    walk.do(lambda t: walk.session.consent("001-consent", False, t))
    assert walk.session.state.ended == "declined" and walk.again().state.ended == "declined"
    for refused in (lambda: walk.do(walk.session.submit, "002-nasa-tlx"), lambda: walk.do(walk.session.repeat)):
        with pytest.raises(ProtocolError) as error:
            refused()
        assert error.value.code == "ended"
    assert walk.do(walk.session.pause) == walk.do(walk.session.page_lost) == walk.do(walk.session.tick) == []


def test_a_crash_in_a_task_begins_it_anew_and_in_a_questionnaire_keeps_the_answers(walk: Walk) -> None:
    walk.to("questionnaire")
    walk.do(walk.session.answer, walk.name, "mental", 35, 2.0)
    walk.session = walk.again()
    walk.open()
    assert walk.session.state.answers == {"mental": 35} and walk.session.state.attempt == 1
    walk.to("task", "running")
    walk.t += 4
    walk.session = walk.again()
    walk.open()
    assert (walk.session.state.phase, walk.session.state.attempt) == ("instruction", 2)
    walk.do(walk.session.ready, walk.name)
    assert walk.session.left(walk.t) == 3
    walk.t += 3
    walk.do(walk.session.tick)
    assert walk.session.left(walk.t) == 10  # the whole of it


def test_what_is_sent_again_is_written_once(walk: Walk) -> None:
    walk.to("questionnaire")
    name = walk.name
    assert len(walk.do(walk.session.answer, name, "mental", 35, 2.0)) == 1
    assert walk.do(walk.session.answer, name, "mental", 35, 2.0) == []
    assert len(walk.do(walk.session.answer, name, "mental", 40, 2.0)) == 1  # thought better of
    walk.answer_all()
    assert walk.do(walk.session.submit, name)
    assert walk.do(walk.session.submit, name) == []
    assert walk.do(walk.session.answer, name, "mental", 0, 2.0) == []  # what it was at the end
    with pytest.raises(ProtocolError, match="finished"):
        walk.do(walk.session.answer, name, "mental", 5, 2.0)
    assert walk.session.state.given[name]["mental"] == 0
    assert walk.do(lambda t: walk.session.consent("001-consent", True, t)) == []


def test_no_answer(walk: Walk) -> None:
    walk.to("questionnaire")
    for value in (-5, 101, 3, "35", True, None, float("nan"), float("inf"), [35], {"a": 1}, 10**400):
        with pytest.raises(ProtocolError) as error:
            walk.do(walk.session.answer, walk.name, "mental", value, 1.0)
        assert error.value.code == "bad_answer" and not walk.session.state.answers
    while walk.name != "011-own":
        walk.step()
    for item, value in (("sex", "third"), ("sex", 1), ("words", "x" * 4001), ("words", "\ud800"), ("nope", 1)):
        with pytest.raises(ProtocolError):
            walk.do(walk.session.answer, walk.name, item, value, 1.0)
    for item, value in (("sex", "one"), ("odd", 1), ("fine", 0)):  # words need not be written
        walk.do(walk.session.answer, walk.name, item, value, 1.0)
    walk.do(walk.session.submit, walk.name)
    assert walk.session.state.ended == "done"


def test_steps_are_done_in_their_order(walk: Walk) -> None:
    walk.to("questionnaire")
    for refused in (
        lambda: walk.do(walk.session.submit, "005-fast-movement"),
        lambda: walk.do(walk.session.ready, "003-fast-wave"),
        lambda: walk.do(walk.session.submit, "nowhere"),
        lambda: walk.do(lambda t: walk.session.consent(walk.name, True, t)),
    ):
        with pytest.raises(ProtocolError) as error:
            refused()
        assert error.value.code == "wrong_step"
    with pytest.raises(ProtocolError, match="6 items are not answered yet"):
        walk.do(walk.session.submit, walk.name)


def test_pause_stops_the_time_as_does_a_page_that_is_gone(walk: Walk) -> None:
    walk.to("task", "countdown")
    walk.do(walk.session.page_lost)
    assert walk.session.state.phase == "instruction" and walk.do(walk.session.page_lost) == []
    walk.to("task", "running")
    walk.t += 9
    walk.do(walk.session.pause)
    assert walk.do(walk.session.pause) == []
    walk.t += 1000
    assert walk.do(walk.session.tick) == [] and walk.session.left(walk.t) is None
    assert walk.again().state.paused  # a server that comes back is still paused
    walk.do(walk.session.resume)
    assert (walk.session.state.phase, walk.session.state.attempt) == ("instruction", 3)
    walk.to("questionnaire")
    walk.do(walk.session.pause)
    with pytest.raises(ProtocolError) as error:
        walk.do(walk.session.answer, walk.name, "realism", 1, 1.0)
    assert error.value.code == "paused"


def test_repeat_forgets_the_answers_and_keeps_the_lines(walk: Walk) -> None:
    walk.to("questionnaire")
    walk.do(walk.session.answer, walk.name, "mental", 35, 2.0)
    walk.do(walk.session.repeat)
    assert walk.session.state.answers == {} and walk.session.state.attempt == 2
    assert any(event.values.get("value") == 35 for event in walk.log)
    walk.do(walk.session.answer, walk.name, "mental", 60, 2.0)
    assert walk.again().state.answers == {"mental": 60}


def test_notes_and_the_end(walk: Walk) -> None:
    walk.to("task")
    before = walk.session.state
    walk.do(walk.session.note, "the strap was loose")
    assert walk.session.state == before
    for text in ("", "  ", "x" * 10_001, "\udcff"):
        with pytest.raises(ProtocolError):
            walk.do(walk.session.note, text)
    walk.do(walk.session.abort, "felt sick")
    assert walk.again().state.ended == "aborted" and walk.log[-1].values == {"reason": "felt sick"}


@pytest.mark.parametrize("seed", range(2))
def test_anything_anytime(tmp_path: Path, seed: int) -> None:
    """Whoever does what they like finds it refused or done; steps only go on, and the log tells the same."""
    walk, rng = Walk(tmp_path, 1 + seed % 6), np.random.default_rng(seed)
    session = walk.session
    walk.open()
    names = [step.name for step in walk.steps]
    for number in range(250):
        walk.t += float(rng.exponential(2))
        at, name = (
            session.state.at,
            str(rng.choice(names[max(0, session.state.at - 1) : session.state.at + 2] or names)),
        )
        item, value = str(rng.choice(["mental", "realism", "sex"])), rng.choice([0, 1, 50]).item()
        doing: list[Callable[[], Any]] = [
            lambda name=name: walk.do(lambda t: session.consent(name, True, t)),
            lambda name=name: walk.do(session.ready, name),
            lambda name=name, item=item, value=value: walk.do(session.answer, name, item, value, 1.0),
            lambda name=name: walk.do(session.submit, name),
            lambda: walk.do(session.tick),
            lambda: walk.do(session.page_lost),
            lambda: walk.do(session.pause),
            lambda: walk.do(session.resume),
            lambda: walk.do(session.repeat),
            lambda: walk.open(),
            walk.step if not session.state.paused and session.step else lambda: None,
            walk.step if not session.state.paused and session.step else lambda: None,
        ]
        try:
            doing[int(rng.integers(len(doing)))]()
        except ProtocolError:
            pass
        assert at <= session.state.at <= at + 1
        if number % 10 == 0:
            assert walk.again().state == session.state
    assert walk.again().state == session.state
    assert session.state.at > 1
