"""Makers of avatars that need no photograph: they are imported again in the process that works."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from glsplat.avatar import Avatar
from glsplat.data import default_avatar
from glsplat.errors import GlsplatError
from glsplat.extras.uploads.job import LowConfidenceError, Order, Progress

__all__ = ["PICTURE", "make"]

_FAULTS = (("front", "small", "Come nearer."), ("back", "dark", "Make more light."))
PICTURE = b"\xff\xd8 not looked at \xff\xd9"


def make(order: Order, progress: Progress) -> Avatar:
    """Does what the words in the front picture say; otherwise a person of 400 splats, made in two steps."""
    word = order.pictures["front"].decode("latin-1")
    progress("looking at the picture", 0.5)
    if "wait" in word:
        time.sleep(600)
    if "hold" in word:
        _until_there(Path(word.partition("hold ")[2]))
    if "long" in word:
        time.sleep(4)
    if "crash" in word:
        os.kill(os.getpid(), signal.SIGSEGV)
    if "exit" in word:
        raise SystemExit(f"the picture said {word}")
    if "fault" in word:
        raise ValueError(f"the picture said {word}")
    if "memory" in word:
        raise MemoryError(word)
    if "print" in word:
        print(word, flush=True)
        os.write(2, word.encode())
    if "refuse" in word:
        raise GlsplatError("the JPEG file is damaged;\n  copy it again")
    if "many" in word:
        raise LowConfidenceError("\U00010000" * 70_000, [("front", "small", "\U00010000" * 5000)] * 100)
    if "doubt" in word and not order.anyway:
        go_on = partial(_finished, order, progress, word) if "known" in word else None
        raise LowConfidenceError("the picture has two faults", _FAULTS, go_on)
    return _finished(order, progress, word)


def _finished(order: Order, progress: Progress, word: str) -> Avatar:
    if "worse" in word:
        raise LowConfidenceError("the body does not fit", _FAULTS[:1], partial(_finished, order, progress, "known"))
    if "busy" in word:
        for step in range(1000):
            progress(f"step {step}", 2.0)
    progress("making the person", 1.0)
    avatar = thinned(default_avatar(), 1 if "large" in word else 100, dict(order.pictures), order.height)
    avatar = replace(avatar, meta=dict(avatar.meta) | {"process": os.getpid(), "title": order.title})
    if "guess" in word:
        noted = [{"side": "front", "code": "arms", "text": "Hold your arms away."}, "no finding"]
        avatar = replace(avatar, meta=dict(avatar.meta) | {"guessed": noted})
    return avatar


def _until_there(file: Path) -> None:
    while not file.exists():
        time.sleep(0.01)


def thinned(avatar: Avatar, every: int, pictures: dict[str, bytes], height: float | None) -> Avatar:
    keep = np.arange(0, len(avatar.splats), every)
    splats = avatar.splats.take(keep)
    splats = replace(splats, scales=splats.scales * every**0.5)
    meta = {"source": "a stub", "pictures": ",".join(sorted(pictures)), "height": str(height)}
    shapes = None if avatar.shapes is None else avatar.shapes.take(keep)
    return replace(avatar, splats=splats, skin=avatar.skin.take(keep), shapes=shapes, meta=meta)
