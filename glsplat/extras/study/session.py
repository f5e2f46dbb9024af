"""The state machine of a session: events change it, without files, sockets and clocks.

Each method for an action returns the events to write, or refuses. ``apply`` changes the state once an event is on disk;
applying a log restores its last state. Times are seconds since the session began.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from glsplat.errors import FormatError, ProtocolError
from glsplat.extras.study.design import Study, Task
from glsplat.extras.study.plan import Step
from glsplat.extras.study.questionnaires import Answer, is_text

MAX_NOTE = 10_000  # characters


@dataclass(frozen=True, slots=True)
class Event:
    """One line of a participant's log."""

    t: float
    step: str
    kind: str
    values: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class State:
    """State of a session. Tasks have the phases instruction, countdown, running; other steps have one phase."""

    at: int = 0  # number of finished steps
    phase: str = ""
    since: float = 0.0  # start of the phase
    attempt: int = 1  # of the step
    paused: bool = False
    ended: str = ""  # done, declined or aborted
    answers: Mapping[str, Answer] = field(default_factory=dict)  # of the current step, by item
    given: Mapping[str, Mapping[str, Answer]] = field(default_factory=dict)  # of finished steps, by name


class Session:
    """One participant's progress through ``steps``."""

    def __init__(self, study: Study, steps: Sequence[Step]) -> None:
        self.study, self.steps = study, tuple(steps)
        self.state = State(phase=_first_phase(self.steps[0]))
        self._replayed = 0

    def replay(self, event: Event) -> None:
        """Apply the next event of a log. Raises FormatError naming its line if it belongs to another plan."""
        self._replayed += 1
        if event.step != self._name:
            raise FormatError(
                f"line {self._replayed}: expected the step {self._name!r}, not {event.step!r:.60}: "
                "a log of another plan"
            )
        self.apply(event)

    @property
    def step(self) -> Step | None:
        """The current step; None at the end."""
        return self.steps[self.state.at] if self.state.at < len(self.steps) and not self.state.ended else None

    @property
    def task(self) -> Task | None:
        """The task of the current step, or None."""
        step = self.step
        return next((one for one in self.study.tasks if step is not None and one.name == step.task), None)

    def left(self, t: float) -> float | None:
        """Return the seconds until the phase ends; None: it has no time limit."""
        step, task, phase = self.step, self.task, self.state.phase
        if step is None or self.state.paused:
            return None
        lasts: float | None = None
        if step.kind == "rest":
            lasts = self.study.rest
        elif task is not None:
            reading = None if task.ready else task.reading
            lasts = {"instruction": reading, "countdown": float(task.countdown), "running": task.seconds}[phase]
        return None if lasts is None else max(0.0, self.state.since + lasts - t)

    # actions; each returns the events to write

    def open(self, t: float, values: Mapping[str, Any]) -> list[Event]:
        """Start or resume the session on a server."""
        step = self.step
        opened = Event(t, "" if step is None else step.name, "open", values)
        return [opened, *self._begin(t, self.state.at)]

    def consent(self, step: str, accepted: bool, t: float) -> list[Event]:
        """Accept or decline the consent text, which is logged with its hash."""
        if (finished := self._finished(step, "consent")) is not None:
            return finished
        text = self.study.consent
        digest = hashlib.sha256(text.encode()).hexdigest()
        event = Event(t, step, "consent", {"accepted": accepted, "sha256": digest, "text": text})
        return [event, *(self._begin(t, self.state.at + 1) if accepted else [])]

    def ready(self, step: str, t: float) -> list[Event]:
        """Start the task after its instruction."""
        if (finished := self._finished(step, "task")) is not None:
            return finished
        return [self._phase(t)] if self.state.phase == "instruction" else []

    def answer(self, step: str, item: str, value: Any, seconds: float, t: float) -> list[Event]:
        """Answer an item; a later answer replaces it."""
        if (finished := self._finished(step, "questionnaire", (item, value))) is not None:
            return finished
        questionnaire = self.study.questionnaires[self.steps[self.state.at].questionnaire]
        if item not in [one.name for one in questionnaire.items]:
            raise ProtocolError("this questionnaire has no item of that name", "bad_answer")
        if why := questionnaire[item].scale.check(value):
            raise ProtocolError(f"{item}: {why}", "bad_answer")
        if item in self.state.answers and self.state.answers[item] == value:
            return []  # repeated after a lost acknowledgement
        took = round(seconds, 2) if 0 <= seconds <= 86400 else None
        return [Event(t, step, "answer", {"item": item, "value": value, "seconds": took})]

    def submit(self, step: str, t: float) -> list[Event]:
        """Finish the questionnaire."""
        if (finished := self._finished(step, "questionnaire")) is not None:
            return finished
        questionnaire = self.study.questionnaires[self.steps[self.state.at].questionnaire]
        missing = [one.name for one in questionnaire.items if one.required and one.name not in self.state.answers]
        if missing:
            raise ProtocolError(f"{len(missing)} items are not answered yet, the first is {missing[0]}", "bad_answer")
        return [Event(t, step, "submit", {"answers": len(self.state.answers)}), *self._begin(t, self.state.at + 1)]

    def tick(self, t: float) -> list[Event]:
        """End the phase if its time is over."""
        left, step = self.left(t), self.step
        if left is None or left > 0 or step is None:
            return []
        if step.kind == "task" and self.state.phase != "running":
            return [self._phase(t)]
        return [Event(t, step.name, "done", {"attempt": self.state.attempt}), *self._begin(t, self.state.at + 1)]

    def page_lost(self, t: float) -> list[Event]:
        """Record that the participant's page is gone: a running task restarts when it is back."""
        under_way = self.state.phase in ("countdown", "running") and not self.state.paused
        return [Event(t, self._name, "lost")] if under_way and self.step is not None else []

    def pause(self, t: float) -> list[Event]:
        """Pause the session."""
        return [Event(t, self._name, "pause")] if self.step is not None and not self.state.paused else []

    def resume(self, t: float) -> list[Event]:
        """Resume a paused session; a running task restarts."""
        return [Event(t, self._name, "continue")] if self.step is not None and self.state.paused else []

    def repeat(self, t: float) -> list[Event]:
        """Restart the current step."""
        if self.step is None:
            raise ProtocolError("the session has ended; nothing is repeated", "ended")
        return [Event(t, self._name, "repeat", {"attempt": self.state.attempt + 1})]

    def note(self, text: str, t: float) -> list[Event]:
        """Add a note of the experimenter."""
        if not text.strip() or len(text) > MAX_NOTE or not is_text(text):
            raise ProtocolError(f"a note has 1 to {MAX_NOTE} characters", "bad_note")
        return [Event(t, self._name, "note", {"text": text})]

    def abort(self, reason: str, t: float) -> list[Event]:
        """End the session early."""
        if len(reason) > MAX_NOTE or not is_text(reason):
            raise ProtocolError(f"a reason has at most {MAX_NOTE} characters", "bad_note")
        return [Event(t, self._name, "abort", {"reason": reason})] if self.step is not None else []

    def makes_progress(self, event: Event) -> bool:
        """Return whether an event is needed to finish: not a changed answer, nor the restart of a task."""
        return event.kind != "lost" and not (event.kind == "answer" and event.values["item"] in self.state.answers)

    def apply(self, event: Event) -> None:
        """Change the state by an event of the log. Other kinds are skipped."""
        now, step = self.state, self.step
        if step is None:
            return
        first = replace(now, phase=_first_phase(step), since=event.t, attempt=now.attempt + 1)
        if event.kind in ("submit", "done") or (event.kind == "consent" and event.values["accepted"]):
            self._advance(event.t)
        elif event.kind == "answer":
            self.state = replace(now, answers={**now.answers, event.values["item"]: event.values["value"]})
        elif event.kind == "phase":
            self.state = replace(now, phase=event.values["phase"], since=event.t)
        elif event.kind in ("open", "lost", "continue"):
            under_way = now.phase in ("countdown", "running")
            self.state = first if under_way else replace(now, since=event.t)
            if event.kind == "continue":
                self.state = replace(self.state, paused=False)
        elif event.kind == "pause":
            self.state = replace(now, paused=True)
        elif event.kind == "repeat":
            self.state = replace(first, answers={})
        elif event.kind in ("consent", "abort"):
            self.state = replace(now, ended="declined" if event.kind == "consent" else "aborted")

    def _advance(self, t: float) -> None:
        now, step = self.state, self.steps[self.state.at]
        given = {**now.given, step.name: now.answers} if step.kind == "questionnaire" else now.given
        at, paused = now.at + 1, now.paused
        if at == len(self.steps):
            self.state = State(at, since=t, ended="done", given=given)
        else:
            self.state = State(at, _first_phase(self.steps[at]), t, paused=paused, given=given)

    @property
    def _name(self) -> str:
        return "" if self.step is None else self.step.name

    def _finished(self, step: str, kind: str, answer: tuple[str, Any] | None = None) -> list[Event] | None:
        """Return None for the current step; [] for a finished step with the same answer. Raises ProtocolError."""
        now = self.step
        number = next((at for at, one in enumerate(self.steps) if one.name == step), None)
        if number is not None and number < self.state.at and self.steps[number].kind == kind:
            if answer is None or self.state.given.get(step, {}).get(answer[0]) == answer[1]:
                return []
            raise ProtocolError("this questionnaire is finished; its answers stay as they are", "wrong_step")
        if now is None:
            raise ProtocolError(f"the session has ended ({self.state.ended})", "ended")
        if now.name != step or now.kind != kind:
            raise ProtocolError("this is not the current step; fetch the state again", "wrong_step")
        if self.state.paused:
            raise ProtocolError("the experimenter has paused the session; wait until it continues", "paused")
        return None

    def _phase(self, t: float) -> Event:
        task = self.task
        assert task is not None
        counts = self.state.phase == "instruction" and task.countdown > 0
        phase = "countdown" if counts else "running"
        return Event(t, self._name, "phase", {"phase": phase, "attempt": self.state.attempt})

    def _begin(self, t: float, at: int) -> list[Event]:
        """Return the event of a step's beginning, with its whole condition for readers of the log."""
        if at >= len(self.steps) or self.state.ended:
            return []
        step = self.steps[at]
        values: dict[str, Any] = {"what": step.kind, "position": step.position}
        if step.condition:
            shown = self.study.condition(step.condition)
            values |= {"condition": shown.name, "avatar": shown.avatar, "view": shown.view, "light": list(shown.light)}
            values |= {"latency": shown.latency, "hands": shown.hands}
        return [Event(t, step.name, "begin", values)]


def _first_phase(step: Step) -> str:
    return {"task": "instruction", "rest": "waiting"}.get(step.kind, "asking")
