"""What every format of the registry owes: a new one gets these tests by its row in the registry.

A format that is only read needs a row in WRITERS; one whose files are packed a row in PACKED, so that the lies get in.
"""

from __future__ import annotations

import gzip
import io
import time
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.formats import Format, all_formats, load, losses, recognise, save
from glsplat.splats import Splats
from tests.formats.scenes import FIELDS, assert_equal, awkward_splats, random_splats

SMALL = 8_000_000  # bytes that a reader may allocate for a small file, as in test_fuzz.py: it works in blocks
COUNT = 4321  # splats; no other number of the files is likely to be this one
WRITERS: dict[str, Callable[[Splats], bytes]] = {}
if "ksplat" in all_formats():
    from tests.extras.formats.ksplats import ksplat

    WRITERS["ksplat"] = lambda splats: ksplat([splats], 0)[0]
UNCOUNTED = {"splat"}  # the file's size is all that says how many there are


def _rezipped(change: Callable[[bytes], bytes], data: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w") as new:
        for name in old.namelist():
            new.writestr(name, change(old.read(name)) if name == "meta.json" else old.read(name))
    return out.getvalue()


PACKED: dict[str, Callable[[Callable[[bytes], bytes], bytes], bytes]] = {
    "spz": lambda change, data: gzip.compress(change(gzip.decompress(data))),
    "sog": _rezipped,
}
MESHES = {"obj", "npz", "scene"}  # hold no splats: tests/extras/rigs/test_loading.py, tests/extras/formats/test_npz.py
every = pytest.mark.parametrize(
    "known",
    [one for one in all_formats().values() if one.load and one.name not in MESHES],
    ids=lambda known: known.name,
)
written = pytest.mark.parametrize(
    "known", [one for one in all_formats().values() if one.save], ids=lambda known: known.name
)


def file_of(known: Format, splats: Splats) -> bytes:
    if known.save is None:
        return WRITERS[known.name](splats)
    out = io.BytesIO()
    save(splats, out, format=known.name)
    return out.getvalue()


def refused(path: Path, data: bytes, message: str = ".", reader: Callable[[Path], object] = load) -> None:
    """In one line that begins with the path and goes on with something like ``message``."""
    path.write_bytes(data)
    with pytest.raises(FormatError, match=message) as caught:
        reader(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ") and "\n" not in text and len(text) < 600


def peak_of(call: Callable[[], object]) -> int:
    tracemalloc.start()
    try:
        call()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@every
@pytest.mark.parametrize("count", [0, 1, 2, 17, 300])
def test_as_many_come_back_under_any_name(tmp_path: Path, known: Format, count: int) -> None:
    for degree in (0, 1, 2) if known.save is None else (0, 1, 2, 3):
        splats = random_splats(count, degree)
        data = file_of(known, splats)
        (tmp_path / f"a{known.suffixes[0]}").write_bytes(data)
        (tmp_path / "other.name").write_bytes(data)
        for path in (tmp_path / f"a{known.suffixes[0]}", *([tmp_path / "other.name"] if known.marked else [])):
            assert recognise(path) == known.name
            found = load(path, strict=True)
            assert isinstance(found, Splats) and len(found) == count
            kept = found.sh_degree == degree
            assert not count or kept or any("harmonics" in loss for loss in losses_of(known, splats))


def losses_of(known: Format, splats: Splats) -> list[str]:
    return list(losses(splats, io.BytesIO(), format=known.name)) if known.save else []


@written
def test_the_same_scene_gives_the_same_bytes(known: Format, monkeypatch: pytest.MonkeyPatch) -> None:
    splats = random_splats(600, 2)
    first = file_of(known, splats)
    later = time.time() + 1e6
    monkeypatch.setattr(time, "time", lambda: later)  # some containers have a field for it
    assert file_of(known, splats) == first


@written
def test_what_was_read_is_written_as_it_came(tmp_path: Path, known: Format) -> None:
    """Rounding happens once: a third file says what the second said."""
    first = load(io.BytesIO(file_of(known, random_splats(200, 1))), format=known.name)
    assert isinstance(first, Splats)
    second = load(io.BytesIO(file_of(known, first)), format=known.name)
    assert isinstance(second, Splats) and len(second) == len(first)
    for name in ("means", "opacities"):
        np.testing.assert_allclose(getattr(second, name), getattr(first, name), atol=2e-3)


@written
def test_what_is_not_finite_is_kept_dropped_or_hidden_and_never_crashes(tmp_path: Path, known: Format) -> None:
    path = tmp_path / f"a{known.suffixes[0]}"
    said: list[str] = []
    save(awkward_splats(), path, say=said.append)
    found = load(path)
    assert isinstance(found, Splats)
    if not all(np.isfinite(getattr(found, name)).all() for name in FIELDS):
        with pytest.raises(FormatError, match="of 10 splats hold NaN or infinity"):
            load(path, strict=True)
    else:
        assert said  # NaN went in and does not come out


@every
def test_an_open_file_and_a_path_are_the_same(tmp_path: Path, known: Format) -> None:
    data = file_of(known, random_splats(50, 1))
    (tmp_path / f"a{known.suffixes[0]}").write_bytes(data)
    stream = io.BytesIO(b"before" + data)
    stream.seek(6)
    one, other = load(tmp_path / f"a{known.suffixes[0]}"), load(stream, format=known.name)
    assert isinstance(one, Splats) and isinstance(other, Splats)
    assert_equal(one, other)


@every
def test_cut_anywhere_it_is_refused(tmp_path: Path, known: Format) -> None:
    data = file_of(known, random_splats(60, 1))
    path = tmp_path / f"a{known.suffixes[0]}"
    for size in {*range(1, min(200, len(data)), 9), *np.linspace(1, len(data) - 1, 40).astype(int)}:
        if known.name in UNCOUNTED and size % 32 == 0:
            continue  # a file of fewer splats
        refused(path, data[: int(size)])


def lies(data: bytes) -> list[bytes]:
    """Each place that says COUNT, as text or as a number of 32 bits, made to say something else, at the same length."""
    found = []
    numbers = [number.to_bytes(4, "little") for number in (COUNT, 2**32 - 1, 2**24 - 1, 0, COUNT + 1)]
    for told, *others in ([str(COUNT).encode(), b"9321", b"1321", b"4322"], numbers):
        at = data.find(told)
        while 0 <= at < 20_000:
            found += [data[:at] + other + data[at + len(told) :] for other in others]
            at = data.find(told, at + 1)
    return found


@every
def test_a_lying_count_is_refused_or_harmless_and_allocates_little(tmp_path: Path, known: Format) -> None:
    """Some of what says COUNT is nobody's business, such as how many splats a section could have held."""
    splats, refusals, made = random_splats(COUNT), [], []
    data, path = file_of(known, splats), tmp_path / f"a{known.suffixes[0]}"

    def change(inner: bytes) -> bytes:
        made[:] = made or lies(inner)
        return made.pop()

    def read() -> None:
        try:
            found = load(path)
        except FormatError as error:
            refusals.append(str(error))
        else:
            assert isinstance(found, Splats) and len(found) <= COUNT + 1  # pictures of a SOG have room for more

    pack = PACKED.get(known.name, lambda change, data: change(data))
    if known.name in UNCOUNTED:
        assert not lies(data)
        return
    while True:
        path.write_bytes(pack(change, data))
        assert peak_of(read) < SMALL + 3 * (splats.nbytes + len(data))
        if not made:
            break
    assert refusals  # at least of what claims more than the file holds
    assert all(one.startswith(f"{path}: ") and "\n" not in one and len(one) < 600 for one in refusals)


@pytest.mark.check
@every
@pytest.mark.parametrize("degree", [0, 2])
def test_memory_is_at_most_three_times_the_splats_and_the_file(tmp_path: Path, known: Format, degree: int) -> None:
    path = tmp_path / f"a{known.suffixes[0]}"
    count = 4_000 if known.save is None else 20_000 if degree else 100_000  # some writers are slow
    path.write_bytes(file_of(known, random_splats(count, degree)))
    assert peak_of(lambda: load(path)) < 3 * (load(path).nbytes + path.stat().st_size)


PARTS: dict[str, Any] = {
    "means": [[0.0, 0, 0], [0.5, 0, 0]],
    "quats": [[1.0, 0, 0, 0]] * 2,
    "scales": [[0.1, 0.1, 0.1]] * 2,
    "opacities": [0.9, 0.8],
    "sh": np.zeros((2, 1, 3)),
}
BROKEN = [(name, value) for name in PARTS for value in (np.nan, np.inf, -np.inf)] + [("quats", 0.0)]


def seen(splats: Splats) -> int:
    """How many the renderer draws and anybody sees."""
    return int((splats.finite() & splats.quats.any(axis=1) & (splats.opacities > 0)).sum())


@written
@pytest.mark.parametrize(("part", "value"), BROKEN)
def test_what_is_never_drawn_is_not_drawn_out_of_a_file(known: Format, part: str, value: float) -> None:
    parts = {key: np.array(array, np.float32) for key, array in PARTS.items()}
    parts[part][0] = value
    splats = Splats(**parts)
    assert seen(splats) == 1
    file, said = io.BytesIO(), []
    save(splats, file, format=known.name, say=said.append)
    file.seek(0)
    again = load(file, format=known.name)
    assert isinstance(again, Splats) and seen(again) == 1
    kept = len(again) == 2 and all(
        np.array_equal(np.isfinite(a), np.isfinite(b)) for a, b in zip(splats.arrays, again.arrays, strict=True)
    )
    assert kept or any("never drawn" in one or "none is drawn" in one for one in said), said
