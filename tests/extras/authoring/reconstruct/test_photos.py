"""Avatars from picture files, by reconstructors chosen by name."""

from __future__ import annotations

from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import cv2
import numpy as np
import pytest

from glsplat.errors import CaptureError, FormatError, GlsplatError
from glsplat.extras.authoring.check.capture import Finding
from glsplat.extras.authoring.check.photos import check_photos
from glsplat.extras.authoring.reconstruct import from_photos, registry
from glsplat.extras.authoring.reconstruct.photos import reconstruct
from glsplat.extras.authoring.reconstruct.reconstructor import Options
from glsplat.formats import load, save
from tests.extras.authoring.reconstruct.stubs import Detailed, Plain, replace_check

ARMS = Finding("arms", "an arm lies against the body")
DARK = Finding("dark", "the person is underexposed")


@pytest.fixture
def seen(monkeypatch) -> dict[str, tuple[Finding, ...]]:
    """Return the findings of the check for each side."""
    return replace_check(monkeypatch)


@pytest.fixture
def front(tmp_path) -> Path:
    path = tmp_path / "secret-name.png"
    cv2.imwrite(str(path), np.full((90, 60, 3), 77, np.uint8))
    return path


def test_pictures_masks_and_options_arrive(seen, front, tmp_path) -> None:
    side = tmp_path / "side.png"
    cv2.imwrite(str(side), np.full((80, 50, 3), 99, np.uint8))
    mask = np.zeros((90, 60), bool)
    mask[10:80, 20:40] = True
    steps: list[tuple[str, float]] = []
    maker = Plain()
    avatar = from_photos(
        front,
        left=side,
        masks={"front": mask},
        height=1.74,
        splats=500,
        seed=3,
        steps=0,
        using=maker,
        progress=lambda step, done: steps.append((step, done)),
    )
    ((pictures, masks, options),) = maker.calls
    assert list(pictures) == ["front", "left"] == list(masks)
    assert pictures["front"].rgb[0, 0, 0] == 77 and pictures["left"].rgb.shape == (80, 50, 3)
    assert np.array_equal(masks["front"], mask) and masks["left"].all()
    assert (options.height, options.splats, options.seed, options.steps) == (1.74, 500, 3, 0)
    assert len(avatar.splats) == len(maker.result.splats)
    told = ["checking the front", "checking the left", "checking the pictures", "standing in"]
    assert [step for step, _ in steps] == [*["reading the pictures"] * 2, *told]


def test_findings_refuse_before_any_other_work(seen, front) -> None:
    seen["front"] = (ARMS, DARK)
    maker = Plain()
    with pytest.raises(CaptureError) as caught:
        from_photos(front, using=maker)
    assert str(caught.value) == f"{front}: {ARMS.text}; also {front}: {DARK.text}"
    assert caught.value.findings == (("front", "arms", ARMS.text), ("front", "dark", DARK.text))
    assert not maker.calls and isinstance(caught.value, FormatError)
    assert from_photos(front, using=maker, anyway=True).splats is not None and len(maker.calls) == 1


def test_without_a_person_anyway_does_not_help(seen, front) -> None:
    seen["front"] = (Finding("nobody", "nobody is found"),)
    with pytest.raises(CaptureError, match="nobody is found"):
        from_photos(front, using=Plain(), anyway=True)


def test_a_body_that_does_not_fit_is_refused(seen, front) -> None:
    maker = Detailed(problem="the body covers 61.0% of the person")
    with pytest.raises(CaptureError, match=r"secret-name.png: the body does not fit the picture \(the body covers"):
        from_photos(front, using=maker)
    assert from_photos(front, using=maker, anyway=True).meta["unseen"] == 0.43


def test_metadata_has_the_provenance_and_no_picture(seen, front, monkeypatch, tmp_path) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    shots = check_photos(front, back=front)
    done = reconstruct(shots, using=Detailed(), meta={"consent": "my own", "licence": "mine"})
    assert done.avatar.meta == {
        "source": "2 photographs (front, back)",
        "made_by": "glsplat 0.1.0, Detailed",
        "date": "2023-11-14",
        "consent": "my own",
        "licence": "mine",
        "body_model": "SMPL-X joints (55)",
        "unseen": 0.43,
    }
    save(done.avatar, tmp_path / "a.glb")
    again = reconstruct(check_photos(front, back=front), using=Detailed(), meta=done.avatar.meta)
    save(again.avatar, tmp_path / "b.glb")
    data = (tmp_path / "a.glb").read_bytes()
    assert data == (tmp_path / "b.glb").read_bytes() and b"secret" not in data and b"image" not in data
    assert load(tmp_path / "a.glb").meta["unseen"] == 0.43
    plain = from_photos(front, using=Plain())
    assert plain.meta["consent"] == "not stated" and "unseen" not in plain.meta
    assert plain.meta["source"] == "1 photograph (front)"


def test_the_date_is_source_date_epoch_or_today(seen, front, monkeypatch) -> None:
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    day = from_photos(front, using=Plain()).meta["date"]
    assert len(day) == 10 and day[:2] == "20" and day[4] == day[7] == "-"
    assert from_photos(front, using=Plain(), meta={"date": "2001-02-03"}).meta["date"] == "2001-02-03"
    for wrong in ("", "noon", "1" * 40):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", wrong)
        with pytest.raises(GlsplatError, match="SOURCE_DATE_EPOCH needs whole seconds"):
            from_photos(front, using=Plain())


@pytest.mark.parametrize(
    ("wishes", "message"),
    [
        ({"height": 174}, r"a height needs metres, 0.5 to 2.5, not 174; is it 1.74\?"),
        ({"height": 0.01}, "a height needs metres, 0.5 to 2.5, not 0.01$"),
        ({"height": float("nan")}, "not nan"),
        ({"splats": 99}, "100 to 2000000 splats, not 99"),
        ({"steps": -1}, "steps needs 0 or more, not -1"),
        ({"seed": -1}, "seed needs 0 or more"),
    ],
)
def test_options_out_of_range(wishes, message) -> None:
    with pytest.raises(FormatError, match=message):
        Options(**wishes)
    with pytest.raises(FormatError, match=message):
        from_photos("absent.jpg", **wishes)  # said before the picture is looked for


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (ValueError("no\nweights"), 'the reconstructor "Plain" failed: ValueError: no weights'),
        (GlsplatError("said in one line"), "^said in one line$"),
        (None, "gave None, not an avatar"),
        ("avatar", "gave 'avatar', not an avatar"),
    ],
)
def test_failures_of_plugins(seen, front, result, message) -> None:
    with pytest.raises(GlsplatError, match=message):
        from_photos(front, using=Plain(result))


def test_masks_belong_to_pictures(seen, front) -> None:
    with pytest.raises(FormatError, match='a mask for "back" and no picture; give the back picture, too'):
        from_photos(front, masks={"back": front}, using=Plain())
    with pytest.raises(FormatError, match='a mask for "top" and no picture; front, back, left or right'):
        from_photos(front, masks={"top": front}, using=Plain())


def test_a_transparent_picture_is_its_own_mask(seen, tmp_path) -> None:
    cut = np.full((90, 60, 4), 99, np.uint8)
    cut[..., 3] = 0
    cut[20:70, 10:50, 3] = 255
    cv2.imwrite(str(tmp_path / "cut.png"), cut)
    shots = check_photos(tmp_path / "cut.png")
    assert np.array_equal(shots["front"].capture.mask, cut[..., 3] > 0)


HERE = "tests.extras.authoring.reconstruct.stubs"


@pytest.fixture
def installed(monkeypatch):
    """Replace the installed entry points."""

    def install(**values: str | list[str]) -> None:
        entries = EntryPoints(
            EntryPoint(name, value, registry.GROUP)
            for name, several in values.items()
            for value in ([several] if isinstance(several, str) else several)
        )
        monkeypatch.setattr(registry, "entry_points", lambda **which: entries.select(**which))

    return install


def test_plugins_are_found_and_own_names_are_reserved(installed) -> None:
    installed(other=f"{HERE}:Plain", builtin="nowhere:nothing", lhm="nowhere:nothing")
    assert registry.names() == ("builtin", "lhm", "other")
    assert isinstance(registry.named("other"), Plain)
    with pytest.raises(GlsplatError, match="GLSPLAT_LHM"):
        registry.named("lhm")


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("nowhere:nothing", r'"other" \(nowhere:nothing\) does not load: ModuleNotFoundError: No module named'),
        (f"{HERE}:Nothing", "does not load: AttributeError"),
        (f"{HERE}:small_avatar", 'has no method "reconstruct"'),
        ("json:loads", "does not load: TypeError"),
        ([f"{HERE}:Plain", f"{HERE}:Detailed"], r'several packages have a reconstructor "other" \(tests.*Detailed, '),
    ],
)
def test_errors_of_plugins_are_one_line(installed, value, message) -> None:
    installed(other=value)
    with pytest.raises(GlsplatError, match=message) as caught:
        registry.named("other")
    assert "\n" not in str(caught.value)


def test_unknown_names_list_the_known(installed) -> None:
    installed()
    with pytest.raises(GlsplatError, match=r'no reconstructor is called "lmh"; there are builtin, lhm$'):
        registry.named("lmh")
