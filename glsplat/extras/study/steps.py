"""The steps of a participant's session: consent, questionnaires, and the tasks of each condition."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from glsplat.extras.study.design import Study
from glsplat.extras.study.plan import Plan


@dataclass(frozen=True, slots=True)
class Step:
    """One step of a session. Its ``name`` depends only on the plan."""

    name: str
    kind: Literal["consent", "questionnaire", "task", "rest"]
    position: int = 0  # of the condition in the participant's order, from 1; 0 outside conditions
    condition: str = ""
    task: str = ""
    questionnaire: str = ""

    @property
    def alias(self) -> str:
        """Name on the participant's page: number and kind, without the condition."""
        return f"{self.name.partition('-')[0]}-{self.kind}"


def steps_of(study: Study, plan: Plan, participant: int) -> tuple[Step, ...]:
    """Return all steps of a participant, numbered from 1."""
    found: list[Step] = []

    def add(kind: Literal["consent", "questionnaire", "task", "rest"], what: str, **more: str | int) -> None:
        condition = more.get("condition", "")
        parts = [f"{len(found) + 1:03d}", *([str(condition)] if condition else []), what]
        found.append(Step("-".join(parts), kind, **more))  # type: ignore[arg-type]

    add("consent", "consent")
    for name in study.before:
        add("questionnaire", name, questionnaire=name)
    for position, condition in enumerate(plan.orders[participant - 1], 1):
        if position > 1 and study.rest:
            add("rest", "rest")
        for task in study.tasks:
            add("task", task.name, position=position, condition=condition, task=task.name)
        for name in study.each:
            add("questionnaire", name, position=position, condition=condition, questionnaire=name)
    for name in study.after:
        add("questionnaire", name, questionnaire=name)
    return tuple(found)
