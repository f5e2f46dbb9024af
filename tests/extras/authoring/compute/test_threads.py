"""Work on several cores, products of matrices on one, and sparse systems."""

from __future__ import annotations

import copy
import time
from collections.abc import Iterator
from threading import Event
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from glsplat.extras.authoring.compute.solvers import conjugate_gradients
from glsplat.extras.authoring.compute.threads import (
    _openblas,
    locked_cached_property,
    map_threads,
    one_blas_thread,
    run_in_background,
)


def test_pieces_come_back_in_their_order_and_errors_come_through() -> None:
    def slower_first(piece: int) -> int:
        time.sleep(0.02 * (3 - piece))
        return piece * 10

    assert map_threads(slower_first, [0, 1, 2, 3]) == [0, 10, 20, 30]
    with pytest.raises(ZeroDivisionError):
        map_threads(lambda n: 1 // n, [1, 0])


def test_what_is_done_aside_is_waited_for_and_its_errors_come_through() -> None:
    begun, going_on = Event(), Event()

    def work() -> str:
        begun.set()
        assert going_on.wait(10)
        return "done"

    result = run_in_background(work)
    assert begun.wait(10)  # before anybody asks for the result
    going_on.set()
    assert result() == "done" == result()
    with pytest.raises(ZeroDivisionError):
        run_in_background(lambda: 1 // 0)()


@pytest.fixture
def blas() -> Iterator[list[Any]]:
    """The ways to ask for threads and to set them, of two threads each; as before afterwards."""
    libraries = _openblas()
    if not libraries:
        pytest.skip("numpy has another library for products of matrices")
    before = [get() for get, _ in libraries]
    for _, put in libraries:
        put(2)
    yield libraries
    for (_, put), count in zip(libraries, before, strict=True):
        put(count)


def test_products_are_on_one_core_meanwhile_and_as_before_afterwards(blas: list[Any]) -> None:
    with pytest.raises(KeyError), one_blas_thread():
        assert [get() for get, _ in blas] == [1] * len(blas)
        raise KeyError
    assert [get() for get, _ in blas] == [2] * len(blas)


def test_whoever_leaves_last_gives_the_threads_back(blas: list[Any]) -> None:
    first, second = one_blas_thread(), one_blas_thread()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert [get() for get, _ in blas] == [1] * len(blas)
    second.__exit__(None, None, None)
    assert [get() for get, _ in blas] == [2] * len(blas)


def test_threads_that_ask_at_once_have_it_found_once() -> None:
    class Slow:
        """Counts how often it was asked."""

        times = 0

        @locked_cached_property
        def half(self) -> object:
            """What is found of itself."""
            self.times += 1
            time.sleep(0.1)
            return object()

        @locked_cached_property
        def whole(self) -> list[object]:
            """Asks for the other one from threads while it is found itself."""
            return map_threads(lambda _: self.half, range(4))

    slow = Slow()
    found = map_threads(lambda _: slow.half, range(4)) + slow.whole
    assert slow.times == 1 and len(set(map(id, found))) == 1
    assert copy.deepcopy(slow).times == 1  # no lock is left in it
    assert Slow().half is not slow.half and (Slow.half.__doc__ or "").startswith("What")


@pytest.mark.parametrize("count", [1, 7, 60])
def test_columns_are_solved_as_numpy_solves_them(count: int) -> None:
    rng = np.random.default_rng(count)
    some = rng.normal(size=(count, count)) * (rng.random((count, count)) < 0.2)
    matrix = some @ some.T + np.diag(rng.uniform(0.5, 50, count))
    target = rng.normal(size=(count, 3)) * (1, 1000, 0)
    found = conjugate_gradients(csr_matrix(matrix), target, np.zeros((count, 3)), rtol=1e-10)
    assert np.allclose(found, np.linalg.solve(matrix, target), rtol=1e-7, atol=1e-9)


def test_what_is_solved_already_stays() -> None:
    matrix = csr_matrix(np.diag([1.0, 4.0]) + 0.5)
    answer = np.array([[2.0], [-3.0]])
    assert np.array_equal(conjugate_gradients(matrix, matrix @ answer, answer), answer)
