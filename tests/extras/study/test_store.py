"""A participant's folder: what is there after a crash, a full disk, and somebody who edits it."""

from __future__ import annotations

import errno
import json
import os
import tracemalloc
from pathlib import Path

import pytest

from glsplat.errors import FormatError
from glsplat.extras.study.session import Event
from glsplat.extras.study.store import MAX_LINE_BYTES, SESSION, Log, Store, folders, remove

EVENTS = [Event(float(n), f"{n:03d}-x", "answer", {"item": "é", "value": n / 3, "seconds": 1.5}) for n in range(20)]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    store = Store(tmp_path, 7)
    store.append(EVENTS[:1])
    store.append(EVENTS[1:])
    store.close()
    return tmp_path / "sub-007" / SESSION


def test_what_is_written_is_read(path: Path, tmp_path: Path) -> None:
    assert list(Log(path)) == EVENTS
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [line["n"] for line in lines] == list(range(20))
    assert set(lines[0]) == {"n", "t", "step", "kind", "values", "sum"}
    assert path.stat().st_mode & 0o077 == 0 and path.parent.stat().st_mode & 0o077 == 0
    store = Store(tmp_path, 7)
    store.append([Event(99.0, "y", "note", {"text": "more"})])
    store.close()
    assert list(Log(path))[-1].t == 99 and folders(tmp_path) == {7: path.parent}


def test_every_cut_is_survived(path: Path, tmp_path: Path) -> None:
    """At any byte: the whole lines are there, what is torn is said, and writing goes on behind them."""
    whole = path.read_bytes()
    ends = [at + 1 for at, byte in enumerate(whole) if byte == 10]
    for cut in [*range(0, len(whole), 37), *ends, *(end - 1 for end in ends), len(whole)]:
        path.write_bytes(whole[:cut])
        complete = sum(end <= cut for end in ends)
        log = Log(path)
        assert list(log) == EVENTS[:complete] and log.torn == cut - ([0, *ends][complete])
    path.write_bytes(whole[: ends[3] + 20])
    replayed: list[Event] = []
    store = Store(tmp_path, 7, replayed.append)
    assert replayed == EVENTS[:4] and store.torn == 20 and path.stat().st_size == ends[3]
    store.append([Event(50.0, "y", "note", {})])
    store.close()
    assert [event.t for event in Log(path)] == [0, 1, 2, 3, 50]


@pytest.mark.parametrize(
    "tail", [b"\0" * 100, b"\0" * 100 + b"\n", b'{"n":', b"\xff\xfe\n", b"\n\n", b"[" * 200_000 + b"\n"]
)
def test_rubbish_at_the_end_is_torn(path: Path, tail: bytes) -> None:
    with open(path, "ab") as file:
        file.write(tail)
    log = Log(path)
    assert list(log) == EVENTS and log.torn == len(tail)


def edited(lines: list[bytes]) -> dict[str, list[bytes]]:
    return {
        "changed": [*lines[:5], lines[5].replace(b'"value":', b'"value":1'), *lines[6:]],
        "left out": lines[:5] + lines[6:],
        "twice": lines[:5] + lines[4:],
        "put in": [
            *lines[:5],
            b'{"n":5,"t":5.0,"step":"x","kind":"note","values":{},"sum":"' + b"0" * 32 + b'"}\n',
            *lines[5:],
        ],
        "swapped": [*lines[:5], lines[6], lines[5], *lines[7:]],
        "the last": [*lines[:-1], lines[-1].replace(b"1.5", b"9.5")],
        "renumbered": [lines[0].replace(b'"n":0', b'"n":1'), *lines[1:]],
    }


@pytest.mark.parametrize("how", edited([b""] * 20))
def test_an_edited_log_is_refused(path: Path, tmp_path: Path, how: str) -> None:
    path.write_bytes(b"".join(edited(path.read_bytes().splitlines(keepends=True))[how]))
    with pytest.raises(FormatError, match=r"session.jsonl: line \d+: does not follow"):
        list(Log(path))
    before = path.read_bytes()
    with pytest.raises(FormatError):
        Store(tmp_path, 7)
    assert path.read_bytes() == before


def test_a_full_disk_takes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where it takes a part: the file is as it was, and the next line follows."""
    store = Store(tmp_path, 1)
    store.append(EVENTS[:2])
    write = os.write

    def short(file: int, data: bytes) -> int:
        if len(data) > 30:
            return write(file, bytes(data)[:30])
        raise OSError(errno.ENOSPC, "No space left on device")

    before = (store.folder / SESSION).read_bytes()
    monkeypatch.setattr(os, "write", short)
    with pytest.raises(FormatError, match="No space left on device"):
        store.append(EVENTS[2:4])
    monkeypatch.undo()
    assert (store.folder / SESSION).read_bytes() == before
    store.append(EVENTS[2:3])
    store.close()
    assert list(Log(store.folder / SESSION)) == EVENTS[:3]


def test_what_cannot_be_cut_off_is_not_written_after(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that fails in the middle of an append, and again where that is undone."""
    store = Store(tmp_path, 1)
    store.append(EVENTS[:2])
    write, cut = os.write, os.ftruncate

    def failing(file: int, data: bytes) -> int:
        if len(data) > 100:
            return write(file, bytes(data)[: len(data) - 50])
        raise OSError(errno.EIO, "Input/output error")

    def refused(file: int, size: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "write", failing)
    monkeypatch.setattr(os, "ftruncate", refused)
    with pytest.raises(FormatError, match="Input/output"):
        store.append(EVENTS[2:9])
    monkeypatch.setattr(os, "write", write)
    with pytest.raises(FormatError, match="Input/output"):
        store.append(EVENTS[2:3])
    monkeypatch.setattr(os, "ftruncate", cut)
    store.append(EVENTS[2:3])
    store.close()
    assert list(Log(store.folder / SESSION)) == EVENTS[:3]


def test_a_line_that_would_not_be_read_is_not_written(tmp_path: Path) -> None:
    store = Store(tmp_path, 1)
    most = Event(0.0, "x", "note", {"text": "x" * (MAX_LINE_BYTES - 200)})
    store.append([most])
    with pytest.raises(FormatError, match="a line has at most"):
        store.append([Event(0.0, "x", "note", {"text": "x" * MAX_LINE_BYTES})])
    store.append(EVENTS[:1])
    store.close()
    assert list(Log(store.folder / SESSION)) == [most, EVENTS[0]]


def test_a_log_is_read_in_constant_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """10 MB of answers, and as many bytes torn behind them."""
    monkeypatch.setattr(os, "fsync", lambda file: None)
    store = Store(tmp_path, 1)
    words = Event(1.0, "x", "answer", {"item": "words", "value": "\U00010000" * 4000})  # 48 kB of JSON
    while store.size < 10 << 20:
        store.append([words] * 20)
    store.close()
    path, count = store.folder / SESSION, store.size // 48_000
    with open(path, "ab") as file:
        for _ in range(10):
            file.write(b"\0" * (1 << 20))
    tracemalloc.start()
    seen = 0

    def replay(event: Event) -> None:
        nonlocal seen
        seen += 1

    store = Store(tmp_path, 1, replay)
    store.append([words])
    store.close()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert seen >= count - 1 and store.torn == 10 << 20
    assert peak < 8 << 20  # a few lines and their parsing; a line has at most 1 MiB


def test_a_disk_that_does_not_sync(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(tmp_path, 1)

    def refused(file: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fsync", refused)
    with pytest.raises(FormatError, match="Input/output"):
        store.append(EVENTS[:1])
    monkeypatch.undo()
    store.append(EVENTS[:1])
    store.close()
    assert list(Log(store.folder / SESSION)) == EVENTS[:1]


def test_one_writer(tmp_path: Path) -> None:
    store = Store(tmp_path, 1)
    with pytest.raises(FormatError, match="another process holds it"):
        Store(tmp_path, 1)
    with pytest.raises(FormatError, match="another process holds it"):
        remove(tmp_path, 1)
    store.append(EVENTS)
    assert list(Log(store.folder / SESSION)) == EVENTS  # written before it returns
    store.close()
    Store(tmp_path, 1).close()


def test_deleted_whole(path: Path, tmp_path: Path) -> None:
    (path.parent / "tracking.jsonl").write_text("{}\n")
    (tmp_path / "sub-008").mkdir()
    assert remove(tmp_path, 7) == 2
    assert [p.name for p in tmp_path.iterdir()] == ["sub-008"]
    with pytest.raises(FormatError, match="no data of this participant"):
        remove(tmp_path, 7)


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("a file")
    with pytest.raises(FormatError, match="cannot be made"):
        Store(tmp_path / "data", 1)
