"""A garment's pattern goes around it: stripes do, also where arms hide rows of them or a side is seen aslant."""

from __future__ import annotations

import numpy as np

from glsplat.extras.authoring.paint.inpaint.pattern import goes_around

ROWS, WIDE = 40, 210
GREEN, TAN = np.array([0.2, 0.4, 0.2]), np.array([0.6, 0.5, 0.3])


def garment(other: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rows of green cloth that is tan where ``other`` [WIDE] is true; row, place and colour of all samples."""
    row, column = np.indices((ROWS, WIDE)).reshape(2, -1)
    return np.tile(GREEN, (ROWS, 1)), row, column / WIDE - 0.5, np.where(other[column, None], TAN, GREEN)


STRIPES = np.arange(WIDE) % 10 < 3
SIGN = STRIPES & (np.abs(np.arange(WIDE) - WIDE / 2) < 0.2 * WIDE)


def test_stripes_go_around_and_signs_do_not() -> None:
    for other, expected in ((STRIPES, True), (SIGN, False), (np.zeros(WIDE, bool), False)):
        colour, row, across, look = garment(other)
        assert (goes_around(colour, row, across, look, np.ones(len(row))) == expected).all()


def test_folds_and_shadows_are_no_stripes() -> None:
    """They change the light of a cloth's colour, by much on white; stripes of another hue or far darker ones stay."""
    white = np.array([0.9, 0.9, 0.88])
    for other, expected in ((0.9 * white, False), (0.5 * white, True), (white * (1, 0.85, 0.85), True)):
        _, row, across, _ = garment(STRIPES)
        look = np.where(STRIPES[np.indices((ROWS, WIDE)).reshape(2, -1)[1], None], other, white)
        found = goes_around(np.tile(white, (ROWS, 1)), row, across, look, np.ones(len(row)))
        assert (found == expected).all()


def test_rows_hidden_by_an_arm_do_not_break_a_pattern() -> None:
    for other, expected in ((STRIPES, True), (SIGN, False)):
        colour, row, across, look = garment(other)
        shown = (row < 8) | (row > 31)
        found = goes_around(colour, row[shown], across[shown], look[shown], np.ones(shown.sum()))
        assert (found == expected).all()


def test_a_forearm_across_the_middle_hides_some_parts() -> None:
    colour, row, across, look = garment(STRIPES)
    shown = np.abs(across) > 1.5 / 7  # three of the seven parts
    assert goes_around(colour, row[shown], across[shown], look[shown], np.ones(shown.sum())).all()


def test_a_side_seen_obliquely_does_not_count() -> None:
    """On a turned person, the far side has few oblique samples of one colour."""
    colour, row, across, look = garment(STRIPES)
    far = across < -0.5 + 1 / 7
    look[far] = GREEN
    assert goes_around(colour, row, across, look, np.where(far, 0.2, 1.0)).all()
    assert not goes_around(colour, row, across, look, np.ones(len(row))).any()  # seen well, it has none


def test_rows_with_few_samples_have_no_pattern() -> None:
    colour, row, across, look = garment(STRIPES)
    assert not goes_around(colour, row, across, look, np.full(len(row), 1e-4)).any()


def test_a_few_rows_above_crossed_arms_are_the_cloth_below_them() -> None:
    """Two rows of the chest alone, in whose middle a tie hangs, would not tell; with the belly's they do."""
    rows = 80
    row, column = np.indices((rows, WIDE)).reshape(2, -1)
    look = np.where(STRIPES[column, None], TAN, GREEN)
    shown = (row < 25) | (row > 75)
    look[(row > 75) & (np.abs(column - WIDE / 2) > 0.3 * WIDE)] = GREEN  # sides that arms have cut off
    found = goes_around(
        np.tile(GREEN, (rows, 1)), row[shown], column[shown] / WIDE - 0.5, look[shown], np.ones(shown.sum())
    )
    assert found.all()
