"""The mixed model once more with whole matrices, as the papers have it, and what it does where nothing varies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

from glsplat.errors import FormatError
from glsplat.study.analysis.effects import hypothesis
from glsplat.study.analysis.mixed import Fit, fit
from glsplat.study.analysis.mixed import test as kenward_roger
from glsplat.study.analysis.power import Planned
from glsplat.study.analysis.table import Table


def gappy(seed: int, people: int = 9, spread: float = 1.0) -> Table:
    """2 between x 3 within, a fifth of the answers missing."""
    rng = np.random.default_rng(seed)
    table = Planned({"g": ("a", "b"), "w": ("x", "y", "z")}, people, frozenset({"g"})).table
    values = (
        rng.normal(size=len(table.cell)) + spread * rng.normal(size=people)[table.participant] + 0.4 * table.codes[:, 1]
    )
    kept = rng.random(len(values)) > 0.2
    return replace(table, participant=table.participant[kept], codes=table.codes[kept], values=values[kept])


def dense(table: Table, L: np.ndarray) -> tuple[float, float, float, float]:
    """F, df, and both variances: Kenward and Roger (1997) as written there, matrices of all answers."""
    y, n = table.values, len(table.values)
    X, Z = np.eye(6)[table.cell], np.eye(len(table.names))[table.participant]
    pieces = [Z @ Z.T, np.eye(n)]

    def deviance(logs: np.ndarray) -> float:
        V = sum(np.exp(log) * piece for log, piece in zip(logs, pieces, strict=True))
        inverse = np.linalg.inv(V)
        A = X.T @ inverse @ X
        left = y - X @ np.linalg.solve(A, X.T @ inverse @ y)
        return float(np.linalg.slogdet(V)[1] + np.linalg.slogdet(A)[1] + left @ inverse @ left)

    found = scipy.optimize.minimize(
        deviance, [0.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-13}
    )
    s = np.exp(found.x)
    V = s[0] * pieces[0] + s[1] * pieces[1]
    inverse = np.linalg.inv(V)
    phi = np.linalg.inv(X.T @ inverse @ X)
    P = [-X.T @ inverse @ G @ inverse @ X for G in pieces]
    Q = [[X.T @ inverse @ G @ inverse @ H @ inverse @ X for H in pieces] for G in pieces]
    information = np.array(
        [
            [
                0.5 * np.trace(inverse @ pieces[i] @ inverse @ pieces[j])
                - np.trace(phi @ Q[i][j])
                + 0.5 * np.trace(phi @ P[i] @ phi @ P[j])
                for j in range(2)
            ]
            for i in range(2)
        ]
    )
    W = np.linalg.inv(information)
    adjusted = phi + 2 * phi @ sum(W[i, j] * (Q[i][j] - P[i] @ phi @ P[j]) for i in range(2) for j in range(2)) @ phi
    q = len(L)
    theta = L.T @ np.linalg.inv(L @ phi @ L.T) @ L
    T = [theta @ phi @ P[i] @ phi for i in range(2)]
    a1 = sum(W[i, j] * np.trace(T[i]) * np.trace(T[j]) for i in range(2) for j in range(2))
    a2 = sum(W[i, j] * np.trace(T[i] @ T[j]) for i in range(2) for j in range(2))
    b = (a1 + 6 * a2) / (2 * q)
    g = ((q + 1) * a1 - (q + 4) * a2) / ((q + 2) * a2)
    c1, c2, c3 = (part / (3 * q + 2 * (1 - g)) for part in (g, q - g, q + 2 - g))
    mean = 1 / (1 - a2 / q)
    variance = 2 / q * (1 + c1 * b) / ((1 - c2 * b) ** 2 * (1 - c3 * b))
    rho = variance / (2 * mean**2)
    m = 4 + (q + 2) / (q * rho - 1)
    means = phi @ X.T @ inverse @ y
    f = m / (mean * (m - 2)) * (L @ means) @ np.linalg.inv(L @ adjusted @ L.T) @ (L @ means) / q
    return float(f), float(m), float(s[0]), float(s[1])


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("effect", [(0,), (1,), (0, 1)])
def test_it_is_the_papers_with_whole_matrices(seed: int, effect: tuple[int, ...]) -> None:
    table = gappy(seed)
    model = fit(table, table.values)
    assert isinstance(model, Fit)
    found = kenward_roger(table, effect, model)
    f, df, intercepts, residual = dense(table, hypothesis(table.shape, effect))
    assert (found.f, found.df2) == pytest.approx((f, df), rel=1e-5)
    assert (model.intercepts, model.residual) == pytest.approx((intercepts, residual), rel=1e-4)


def test_participants_who_do_not_differ() -> None:
    """A variance of 0 is a bound, and found exactly; shifting and scaling answers changes nothing."""
    fits = [fit(table, table.values) for table in (gappy(seed, spread=0.0) for seed in range(10, 22))]
    assert any(model is not None and model.intercepts == 0 for model in fits)
    table = gappy(4)
    found = [
        kenward_roger(table, (1,), fit(table, values))
        for values in (table.values, 1e5 + table.values, 1e6 * table.values)
    ]
    assert [test.f for test in found] == pytest.approx([found[0].f] * 3, rel=1e-5)


def test_nothing_that_varies() -> None:
    table = gappy(5)
    assert fit(table, np.ones(len(table.values))) is None
    assert fit(table, table.cell.astype(float)) is None  # cells explain all
    assert fit(table, 1000.0 * table.participant + 1e-9 * table.values) is None  # participants do
    assert np.isnan(kenward_roger(table, (1,), None).f)


def test_too_few_answers() -> None:
    single = Planned({"g": ("a", "b")}, 8, frozenset({"g"})).table
    with pytest.raises(FormatError, match="several answers"):
        fit(single, np.arange(8.0))
