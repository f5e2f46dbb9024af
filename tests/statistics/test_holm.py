"""Holm's correction as published."""

from __future__ import annotations

import pytest

from glsplat.statistics.holm import holm


def test_holm_as_published() -> None:
    """The values of R's p.adjust(c(0.01, 0.04, 0.03, 0.005), "holm")."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.4, 0.9, 0.8]) == [1.0, 1.0, 1.0] and holm([]) == [] and holm([0.2]) == [0.2]
