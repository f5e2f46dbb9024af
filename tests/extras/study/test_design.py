"""study.toml: what it means, and one clear line for everything that it should not say."""

from __future__ import annotations

from pathlib import Path

import pytest

from glsplat.errors import FormatError
from glsplat.extras.study.design import read_study
from glsplat.extras.study.questionnaires import embedded, questionnaire_of
from tests.extras.study.designs import OWN, SMALL, write


def test_what_it_says(tmp_path: Path) -> None:
    study = read_study(write(tmp_path))
    assert [(f.name, f.levels, f.between) for f in study.factors] == [
        ("delay", ("none", "some"), False),
        ("group", ("old", "young"), True),
    ]
    slow = study.condition("slow")
    assert (slow.latency, slow.hands, slow.view, slow.avatar) == (150, False, "mirror", "default")
    assert slow.light == (0.5, 0.25, 1.0) and study.condition("fast").light == (1.0, 1.0, 1.0)
    assert (study.before, study.each, study.after) == (("nasa-tlx",), ("movement",), ("nasa-tlx", "own"))
    assert study.rest == 2 and study.tasks[1].reading == 4
    assert not study.items_without_text


def test_equal_designs_have_equal_digests(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    one, same = read_study(write(tmp_path / "a")), read_study(write(tmp_path / "b", "# a remark\n" + SMALL))
    assert one.digest == same.digest
    for before, after in [("latency = 150", "latency = 151"), ('"Wave."', '"Wave!"'), ("seed = 5", "seed = 6")]:
        assert read_study(write(tmp_path / "b", SMALL.replace(before, after))).digest != one.digest
    assert read_study(write(tmp_path / "b", SMALL, OWN.replace("odd.", "odd!"))).digest != one.digest


WRONG = [
    ("seed = 5", "sead = 5", "sead", "is it seed"),
    ("participants = 6", "participants = 0", "participants", "1 to 999"),
    ('name = "small"', 'name = "Small Study"', "name", "small letters"),
    ('consent = "You look at a body."', 'consent = " "', "consent", "text"),
    ('delay = ["none", "some"]', 'delay = ["none"]', "delay", "2 to 20"),
    ('delay = "some"', 'delay = "none"', "condition", "same levels"),
    ('delay = "some"', 'delay = "much"', "delay", "none, some"),
    ("latency = 150", "latency = nan", "latency", "0 to 2000"),
    ("hands = false", 'view = "behind"', "view", "mirror"),
    ("light = [0.5, 0.25, 1]", 'light = "noon"', "light", "0 to 1"),
    ("light = [0.5, 0.25, 1]", "light = [1, nan, 1]", "light", "0 to 1"),
    ("seconds = 10", "seconds = -1", "seconds", "0.1 to 3600"),
    ('"own.toml"', '"none.toml"', "after", "none.toml"),
    ("seed = 5", "seed = 5\n[order]\nblock = 'group'", "block", "delay"),
    ("seed = 5", "seed = 5\n[text.own]\nnope = 'x'", "nope", "sex"),
]


def test_one_line_names_the_key(tmp_path: Path) -> None:
    for before, after, key, hint in WRONG:
        text = SMALL.replace(before, after, 1) if not after.startswith("seed = 5\n[") else f"{SMALL}\n{after[9:]}"
        assert text != SMALL
        path = write(tmp_path, text)
        with pytest.raises(FormatError) as refused:
            read_study(path)
        line = str(refused.value)
        assert line.startswith(str(path)) and key in line and hint in line and "\n" not in line


WRONG_OWN = [
    ('name = "odd"', 'name = "sex"', "two items"),
    ('items = ["odd", "fine"]', 'items = ["odd", "words"]', "words"),
    ("weights = [1, -2]", "weights = [1]", "2 numbers"),
    ("from = -3, to = 3", "from = 3, to = -3", "steps"),
    ('labels = ["no", "yes"]', 'labels = ["no", "well", "yes"]', "labels"),
    ('kind = "text"', 'kind = "words"', "points, slider"),
]


def test_questionnaires_are_checked_too(tmp_path: Path) -> None:
    for before, after, hint in WRONG_OWN:
        with pytest.raises(FormatError, match=hint):
            read_study(write(tmp_path, SMALL, OWN.replace(before, after, 1)))


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    path = write(tmp_path)
    path.write_bytes(b"name = '\xff'")
    with pytest.raises(FormatError, match="TOML"):
        read_study(path)
    path.write_bytes(b"#" * (2 << 20))
    with pytest.raises(FormatError, match="KiB"):
        read_study(path)


def test_every_instrument_can_be_read() -> None:
    assert len(embedded()) == 8
    for name in embedded():
        one = questionnaire_of(name, Path())
        assert one.name == name and one.source and one.scores
        assert bool(one.items_without_text) == ("not free" in one.licence)


def test_scores_by_hand(tmp_path: Path) -> None:
    study = read_study(write(tmp_path))
    own = study.questionnaires["own"]
    (score,) = own.scores
    assert score.of(own, {"odd": 2, "fine": -1}) == 0.5 * ((1 + 7 - 2) + -2 * -1)
    assert score.of(own, {"odd": 2}) is None
    tlx = study.questionnaires["nasa-tlx"]
    answers = dict(zip([i.name for i in tlx.items], (10, 20, 30, 40, 50, 60), strict=True))
    assert tlx.scores[0].of(tlx, answers) == 35


def test_the_ssq_weighs_as_its_authors_do() -> None:
    """Kennedy et al. (1993), table 5: all symptoms severe give 200.34, 159.18, 292.32 and 235.62."""
    ssq = questionnaire_of("ssq", Path())
    found = {one.name: one.of(ssq, {item.name: 3 for item in ssq.items}) for one in ssq.scores}
    assert found == pytest.approx({"nausea": 200.34, "oculomotor": 159.18, "disorientation": 292.32, "total": 235.62})


def test_the_embodiment_questionnaire_adds_up_as_published() -> None:
    """Gonzalez-Franco and Peck (2018): ((own / 5) 2 + (agency / 4) 2 + tactile / 4 + (location / 3) 2 + ...) / 9."""
    one = questionnaire_of("embodiment", Path())
    answers = {item.name: (n * 5) % 7 - 3 for n, item in enumerate(one.items)}
    found = {score.name: score.of(one, answers) for score in one.scores}
    q = [0, *answers.values()]
    assert found["ownership"] == (q[1] - q[2]) - q[3] + (q[4] - q[5])
    assert found["agency"] == q[6] + q[7] + q[8] - q[9]
    parts = [("ownership", 2 / 5), ("agency", 2 / 4), ("tactile", 1 / 4), ("location", 2 / 3), ("appearance", 1 / 4)]
    parts.append(("response", 1 / 5))
    assert found["total"] == pytest.approx(sum(w * (found[name] or 0) for name, w in parts) / 9)
