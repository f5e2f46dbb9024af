"""Whether the report and ``glsplat bench`` say the same: the default setting by both, in one process."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

from glsplat.avatar import Avatar
from glsplat.gl.context import Context
from glsplat.views import splats_of

from ..bench import WARM_UP, Bench
from .measure import Tick, frame_cost
from .subjects import Subject

__all__ = ["LOADED", "agreement", "agreement_cost", "verdict"]

RENDERS = 11
"""Pictures of one view that a frame of ``glsplat bench`` takes for a pair."""

TOLERANCE = 0.1
"""Share by which two medians may differ on a machine that does nothing else, where their own spread is smaller."""


LOADED = (
    "Report and bench measured the same frames at different times and differ by more than their own spread: mostly "
    "because the machine did something else meanwhile. Compare settings with each other: they took turns."
)
"""What to think of a difference; the report's own numbers hold beside each other either way."""


def verdict(row: Mapping[str, Any]) -> str:
    """One row of ``agreement`` in words."""
    apart = abs(row["report_ms"]["median"] - row["bench_ms"]["median"])
    return (
        f"{'agree' if row['agree'] else 'differ'} ({apart:.2f} ms apart, {row['allowed_ms']:.2f} are within the spread)"
    )


def agreement_cost(subjects: Sequence[Subject], frames: int) -> float:
    """How much ``agreement`` will tell its ``tick``."""
    return sum(_cost(subject) for subject in subjects) * (WARM_UP + frames)


def agreement(
    context: Context, subjects: Sequence[Subject], scenes: Sequence[dict[str, Any]], frames: int, tick: Tick
) -> list[dict[str, Any]]:
    """One row a subject that orbits: its default among ``scenes`` (``report_measure``) beside what bench measures now.

    They agree if their medians differ by no more than the wider of the two spreads (95th percentile less median), or a
    tenth.
    """
    rows = []
    for subject, scene in zip(subjects, scenes, strict=True):
        size = (subject.size, subject.size)
        bench = Bench(context, argparse.Namespace(frames=frames, float_target="auto", sorter="auto"))
        poses = [subject.pose(i) for i in range(WARM_UP + frames)]
        measured = bench.setting(subject.name, subject.scene, poses, size, 2)
        tick(_cost(subject) * (WARM_UP + frames))
        ours, theirs = scene["settings"][0]["ms"], measured["frame_ms"]
        spread = max(ms["p95"] - ms["median"] for ms in (ours, theirs))
        allowed = max(spread, TOLERANCE * theirs["median"])
        rows.append(
            {
                "scene": subject.name,
                "size": subject.size,
                "report_ms": ours,
                "bench_ms": theirs,
                "ratio": round(ours["median"] / theirs["median"], 3),
                "allowed_ms": round(allowed, 3),
                "agree": abs(ours["median"] - theirs["median"]) <= allowed,
            }
        )
    return rows


def _cost(subject: Subject) -> float:
    scene = subject.scene.splats if isinstance(subject.scene, Avatar) else splats_of(subject.scene)
    return RENDERS * frame_cost(len(scene), subject.size**2)
