"""Makers by themselves."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import pytest

from glsplat.net.uploads.job import UploadConfig
from glsplat.net.uploads.work import Maker
from tests.net.uploads.makers import make
from tests.net.wire import HANG


@pytest.mark.parametrize("how", [Maker.close, Maker.stop])
def test_a_process_is_not_closed_while_another_thread_ends_it(tmp_path: Path, how: Callable[[Maker], None]) -> None:
    """A process that is closed cannot be killed: that raises."""
    maker = Maker(UploadConfig(folder=tmp_path, make=make))
    with ThreadPoolExecutor(1) as other:
        with maker._lock:
            ending = other.submit(how, maker)
            done = wait([ending], 0.2).done
        ending.result(HANG)
    assert not done
