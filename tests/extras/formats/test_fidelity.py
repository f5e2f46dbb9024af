"""What a conversion changed, measured from the file read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.formats.fidelity import fidelity, read_back
from glsplat.formats import all_formats, save
from glsplat.splats import SH_C0, Splats
from tests.formats.scenes import awkward_splats, random_splats

SUFFIXES = [known.suffixes[0] for known in all_formats().values() if known.save]


def two(**changes: object) -> Splats:
    """Two splats, the first as it is changed."""
    values: dict[str, object] = {
        "means": [[1, 2, 3], [0, 0, 0]],
        "quats": [[1, 0, 0, 0], [0.5, 0.5, 0.5, 0.5]],
        "scales": [[0.1, 0.05, 0.2], [1, 1, 1]],
        "opacities": [0.5, 0.25],
        "sh": np.zeros((2, 4, 3)),
    }
    return Splats(**(values | changes))  # type: ignore[arg-type]


def test_differences_by_hand() -> None:
    half = np.radians(10) / 2
    sh = np.zeros((2, 4, 3))
    sh[0, 0, 1] = 0.12 / SH_C0  # 30.6 levels of green
    sh[0, 2, 0], sh[0, 3, 0] = 0.3, 0.4  # 0.5 over sqrt(4 pi): 0.14105, 35.97 levels of red
    found = fidelity(
        two(),
        two(
            means=[[1, 2.003, 3.004], [0, 0, 0]],
            quats=[[-np.cos(half), 0, 0, -np.sin(half)], [0.5, 0.5, 0.5, 0.5]],
            scales=[[0.11, -0.05, 0.2], [1, 1, 1]],  # 0.01 of 0.2; a sign is none
            opacities=[0.45, 0.25],
            sh=sh,
        ),
    )
    for error, largest in (
        (found.positions, 0.005),
        (found.scales, 5),
        (found.rotations, 10),
        (found.colours, 30.6),
        (found.view, 35.968),
        (found.opacities, 0.05),
    ):
        assert error.largest == pytest.approx(largest, rel=1e-4) and error.mean == pytest.approx(largest / 2, rel=1e-4)
    assert len(list(found.words())) == 6


def test_nothing_is_said_of_rounding() -> None:
    splats = random_splats(200, 3)
    nudged = Splats(*(np.nextafter(getattr(splats, n), 9) for n in ("means", "quats", "scales", "opacities", "sh")))
    assert not list(fidelity(splats, nudged).words())
    assert not list(fidelity(random_splats(0), random_splats(0)).words())


def test_one_splat_far_away_hides_no_loss_of_the_others(tmp_path: Path) -> None:
    """Rounding to float32 is that of each splat where it is, not that of the whole scene."""
    means = random_splats(300, 0).means.copy()
    means[0] = 3000
    scene = replace(random_splats(300, 0), means=means)
    for suffix in (".compressed.ply", ".sog"):
        save(scene, tmp_path / f"a{suffix}")
        assert any(words.startswith("positions") for words in read_back(scene, tmp_path / f"a{suffix}").words())


def test_what_is_drawn_alike_is_alike() -> None:
    """Below 0 a colour is drawn as 0, and an opacity outside 0 to 1 as the nearer end."""
    dark, darker = np.full((2, 4, 3), -1 / SH_C0), np.full((2, 4, 3), -2 / SH_C0)
    dark[:, 1:], darker[:, 1:] = 0, 0
    assert not list(fidelity(two(sh=dark, opacities=[1, 0]), two(sh=darker, opacities=[1.5, -1])).words())
    dropped = fidelity(two(sh=np.ones((2, 4, 3))), two(sh=np.ones((2, 1, 3))))
    assert dropped.colours.largest == 0 and dropped.view.largest == pytest.approx(255 * np.sqrt(3 / (4 * np.pi)))


def test_broken_splats_do_not_count() -> None:
    splats = awkward_splats()
    found = fidelity(splats, random_splats(10, 1))
    assert np.isfinite([found.positions.largest, found.rotations.largest, found.scales.mean]).all()
    assert found.positions.largest == 0 and found.rotations.largest == pytest.approx(0, abs=1e-3)


def test_order_and_missing_splats() -> None:
    splats = random_splats(100_000, 0)  # more than one chunk
    order = np.random.default_rng(4).permutation(len(splats))[:-3]
    found = fidelity(splats, splats.take(order), order)
    assert list(found.words()) == ["3 of 100000 splats are not there"]
    assert fidelity(splats, splats.take(np.roll(np.arange(len(splats)), 1))).positions.largest > 1
    with pytest.raises(FormatError, match="99997 splats were read back, not the 100000"):
        fidelity(splats, splats.take(order))


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_format_says_in_which_order_it_writes(tmp_path: Path, suffix: str) -> None:
    """A format that puts splats into another order, or leaves some out, has ``order``: else figures mean nothing."""
    base = random_splats(300, 1)
    means = base.means.copy()
    means[7] = np.nan
    scene = Splats(means, base.quats, base.scales, base.opacities, base.sh)
    save(scene, tmp_path / f"a{suffix}")
    found = read_back(scene, tmp_path / f"a{suffix}")
    assert found.positions.largest < 0.05
    assert found.rotations.largest < 5 and found.colours.mean < 20 and found.opacities.largest < 0.1


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("count", [1, 2, 17, 300])
def test_what_is_read_back_is_near(tmp_path: Path, suffix: str, count: int) -> None:
    for degree in (0, 1, 2, 3):
        splats = random_splats(count, degree)
        save(splats, tmp_path / f"a{suffix}")
        away = read_back(splats, tmp_path / f"a{suffix}")
        assert away.positions.largest < 0.01 and away.opacities.largest < 0.02 and away.rotations.largest < 5
