"""Designs for tests: small ones, as files."""

from __future__ import annotations

from pathlib import Path

from glsplat.extras.study.design import Study, read_study
from glsplat.extras.study.plan import Plan, make_plan

__all__ = ["SMALL", "planned", "write"]

SMALL = """
name = "small"
title = "Small"
participants = 6
seed = 5
rest_s = 2
consent = "You look at a body."

[factors]
delay = ["none", "some"]

[between]
group = ["old", "young"]

[[condition]]
name = "fast"
delay = "none"

[[condition]]
name = "slow"
delay = "some"
latency = 150
hands = false
light = [0.5, 0.25, 1]

[[task]]
name = "wave"
text = "Wave."
seconds = 10
countdown = 3

[[task]]
name = "walk"
text = "Walk in place."
seconds = 5
countdown = 0
ready = false
reading = 4

[questionnaires]
before = ["nasa-tlx"]
each = ["movement"]
after = ["nasa-tlx", "own.toml"]
"""
OWN = """
name = "own"
title = "Own"
[[item]]
name = "sex"
text = "Which?"
scale = {kind = "choice", labels = ["one", "other"]}
[[item]]
name = "words"
text = "What else?"
scale = {kind = "text"}
[[item]]
name = "odd"
text = "It was odd."
reversed = true
[[item]]
name = "fine"
text = "It was fine."
scale = {from = -3, to = 3, labels = ["no", "yes"]}
[[score]]
name = "sum"
items = ["odd", "fine"]
how = "sum"
weights = [1, -2]
factor = 0.5
"""


def write(folder: Path, text: str = SMALL, own: str = OWN) -> Path:
    """The design's file, and the questionnaire's beside it."""
    (folder / "own.toml").write_text(own)
    path = folder / "study.toml"
    path.write_text(text)
    return path


def planned(folder: Path, text: str = SMALL) -> tuple[Study, Plan]:
    study = read_study(write(folder, text))
    return study, make_plan(study)
