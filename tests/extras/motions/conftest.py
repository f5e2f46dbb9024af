"""Fixtures of the tracker's tests."""

from __future__ import annotations

from tests.tracking.conftest import body, skeleton, stage, track

__all__ = ["body", "skeleton", "stage", "track"]
