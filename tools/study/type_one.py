"""How often the study's F tests find what is not there, at alpha = .05: python -m tools.study.type_one [RUNS]

A line a design and effect; all answers are drawn without that effect. About ten minutes with 4000 runs, most of it for
the mixed model, whose studies are fitted one by one. "spread" is with ties spread.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from apps.progress import each
from glsplat.extras.study.analysis.align import ranked, spread_ranks
from glsplat.extras.study.analysis.effects import effects_of
from glsplat.extras.study.analysis.mixed import fit, test
from glsplat.extras.study.analysis.power import Draws, Planned, power
from glsplat.extras.study.analysis.table import Table

TYPE, METHOD = {"type": ("self", "other")}, {"method": ("ours", "video", "image")}
NULLS: dict[str, tuple[Planned, dict[str, tuple[float, ...]]]] = {
    "2 x 3 within, n = 24, normal": (Planned(TYPE | METHOD, 24), {}),
    "2 x 3 within, n = 24, 7 points": (Planned(TYPE | METHOD, 24, points=7), {}),
    "2 x 3 within, n = 24, 5 points": (Planned(TYPE | METHOD, 24, points=5), {}),
    "2 x 3 within, n = 12, 7 points": (Planned(TYPE | METHOD, 12, points=7), {}),
    "2 x 3 within, n = 24, 7 points, type 0.8 SD": (Planned(TYPE | METHOD, 24, points=7), {"type": (0.8,)}),
    "2 between x 3 within, n = 24, normal": (Planned(TYPE | METHOD, 24, frozenset({"type"})), {}),
    "2 between x 3 within, n = 24, 7 points": (Planned(TYPE | METHOD, 24, frozenset({"type"}), points=7), {}),
    "2 between x 3 within, n = 23, 7 points": (Planned(TYPE | METHOD, 23, frozenset({"type"}), points=7), {}),
    "2 x 3 between, n = 48, 7 points": (Planned(TYPE | METHOD, 48, frozenset({"type", "method"}), points=7), {}),
    "2 x 2 x 2 within, n = 16, 7 points": (
        Planned({"a": ("1", "2"), "b": ("1", "2"), "c": ("1", "2")}, 16, points=7),
        {},
    ),
}
MIXED = ("2 x 3 within, n = 24, 7 points", "2 between x 3 within, n = 23, 7 points")


def with_gaps(table: Table, draws: Draws, runs: int, share: float, seed: int, step: float | None) -> dict[str, int]:
    """How often each effect is found by the mixed model where this share of the answers is missing."""
    rng = np.random.default_rng(seed)
    effects = effects_of(len(table.factors))
    found = dict.fromkeys(effects, 0)
    answers = draws(rng, runs)
    for own in each(answers, "studies"):
        kept = rng.random(len(own)) >= share
        few = replace(table, participant=table.participant[kept], codes=table.codes[kept], values=own[kept])
        for effect in effects:
            ranks = ranked(few, effect) if step is None else spread_ranks(few, effect, step)
            found[effect] += test(few, effect, fit(few, ranks)).p < 0.05
    return {":".join(table.factors[i].name for i in effect): k for effect, k in found.items()}


def main(runs: int = 4000) -> None:
    """A line each."""
    for name, (plan, effects) in NULLS.items():
        for kind, steps in (("rm", None), ("spread", 1.0 if plan.points else None)):
            if kind == "rm" or steps:
                for row in power(plan.draws(effects), plan.table, runs=runs, seed=41, step=steps):
                    if row.effect not in effects:
                        print(f"{kind:6} {name:46} {row.effect:12} {100 * row.power:.2f} %  of {runs}", flush=True)
    for name in MIXED:
        plan, effects = NULLS[name]
        for share, step in ((0.0, None), (0.1, None), (0.1, 1.0)):
            for effect, found in with_gaps(plan.table, plan.draws(effects), runs, share, 41, step).items():
                words = f"{name}, {100 * share:.0f} % missing" + (", spread" if step else "")
                print(f"mixed  {words:54} {effect:12} {100 * found / runs:.2f} %  of {runs}", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
