"""State of a running session as JSON for the pages; the participant's has no names of conditions."""

from __future__ import annotations

from typing import Any

from glsplat.extras.study.design import Study
from glsplat.extras.study.questionnaires import Item
from glsplat.extras.study.serving.live import Live


def for_participant(live: Live) -> dict[str, Any]:
    """Return the current step with its text or questions."""
    session = live.session
    step, state, left = session.step, session.state, session.left(live.t)
    shown: dict[str, Any] = {
        "revision": live.revision,
        "title": live.study.title,
        "ended": state.ended,
        "paused": state.paused,
        "number": state.at + 1,
        "of": len(session.steps),
        "trouble": bool(live.trouble),
        "condition": None
        if live.condition is None
        else {"view": live.condition.view, "latency": live.condition.latency},
    }
    if step is None:
        return shown
    shown |= {"step": step.alias, "kind": step.kind, "phase": state.phase, "attempt": state.attempt}
    shown["left"] = None if left is None else round(left, 2)
    if step.kind == "consent":
        shown["text"] = live.study.consent
    task = session.task
    if task is not None:
        shown |= {"text": task.text, "speak": task.speak, "ready": task.ready, "seconds": task.seconds}
    if step.questionnaire:
        shown |= _questions(live.study, step.questionnaire) | {"answers": dict(state.answers)}
    return shown


def for_experimenter(live: Live) -> dict[str, Any]:
    """Return the current step without its questions, and the state of the session."""
    session = live.session
    step = session.step
    condition = None if step is None or not step.condition else step.condition
    shown = live.condition
    return {
        "revision": live.revision,
        "study": live.study.title,
        "participant": live.participant,
        "t": round(live.t, 1),
        "step": "" if step is None else step.name,
        "kind": "" if step is None else step.kind,
        "phase": session.state.phase,
        "attempt": session.state.attempt,
        "left": session.left(live.t),
        "paused": session.state.paused,
        "ended": session.state.ended,
        "number": session.state.at + 1,
        "condition": condition,
        "shown": None if shown is None else {"view": shown.view, "latency": shown.latency, "hands": shown.hands},
        "answered": len(session.state.answers),
        "items": 0
        if step is None or not step.questionnaire
        else len(live.study.questionnaires[step.questionnaire].items),
        "present": live.present,
        "figures": live.figures,
        "trouble": live.trouble,
        "notes": [{"t": round(note.t, 1), "text": note.values["text"]} for note in live.notes],
        "steps": [one.name for one in session.steps],
    }


def _questions(study: Study, name: str) -> dict[str, Any]:
    questionnaire = study.questionnaires[name]
    return {"intro": questionnaire.intro, "items": list(map(_item, questionnaire.items))}


def _item(item: Item) -> dict[str, Any]:
    scale = item.scale
    fields: dict[str, Any] = {"name": item.name, "text": item.text, "kind": scale.kind, "labels": list(scale.labels)}
    if scale.kind in ("points", "slider"):
        fields |= {"from": scale.low, "to": scale.high, "step": scale.step}
    return fields | {"required": item.required}
