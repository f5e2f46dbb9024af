"""Text of an analysis in Markdown: a paragraph for a results section, and tables with all numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from glsplat.extras.study.analysis.analysis import ALPHA, Analysis, EffectRow
from glsplat.extras.study.analysis.anova import Contrast
from glsplat.extras.study.analysis.codebook import Reliability
from glsplat.extras.study.analysis.plain import EffectSize, Omnibus


def results_text(analyses: Sequence[Analysis], scales: Mapping[str, Reliability] | None = None) -> str:
    """Return Markdown with a chapter per response; ``scales`` is the reliability by response."""
    chapters = [_chapter(analysis, (scales or {}).get(analysis.table.response)) for analysis in analyses]
    if len(analyses) > 1:
        chapters.append(
            f"p values are corrected (Holm) within the pairs of one effect, not over the {len(analyses)} responses."
        )
    return "\n\n".join(chapters) + "\n"


def _chapter(analysis: Analysis, scale: Reliability | None) -> str:
    parts = [f"## {_cell(analysis.table.response)}", _design(analysis)]
    if scale is not None:
        parts.append(_scale(scale))
    parts.append(_tests(analysis))
    parts.append(_plain(analysis.plain, analysis.plain_left_out))
    parts.append("### Answers by condition\n\n" + _cells(analysis))
    parts.append("### F tests on aligned ranks\n\n" + _effects(analysis.effects))
    if analysis.contrasts:
        parts.append(
            "### Pairs of conditions (ART-C, p by Holm within each effect)\n\n" + _contrasts(analysis.contrasts)
        )
    if analysis.plain:
        parts.append("### Plain tests\n\n" + _plain_table(analysis.plain))
    return "\n\n".join(part for part in parts if part)


def _design(analysis: Analysis) -> str:
    table, model = analysis.table, analysis.model
    design = " x ".join(f"{len(f.levels)} ({f.name}: {', '.join(f.levels)})" for f in table.factors)
    inside = [f.name for f in table.factors if f.within]
    outside = [f.name for f in table.factors if not f.within]
    kinds = [
        f"{_and(names)} {word} participants" for names, word in ((inside, "within"), (outside, "between")) if names
    ]
    lines = [
        f"{len(table.names)} participants gave {_count(len(table.values), 'answer')} in a {design} design, "
        f"{' and '.join(kinds)}."
    ]
    if analysis.unanswered:
        gone = _count(analysis.unanswered, "answer")
        how = (
            f"participants without every condition were left out ({', '.join(model.left_out)})"
            if model.left_out
            else "the mixed model uses all given answers, which is valid if gaps depend only on given answers"
        )
        lines.append(f"{gone} {'is' if analysis.unanswered == 1 else 'are'} missing; {how}.")
    else:
        lines.append("No answer is missing.")
    again = int((table.answers - 1).clip(0).sum())
    if again:
        are = "answer is" if again == 1 else "answers are"
        lines.append(f"{again} {are} of a condition that the participant had answered before; all count.")
    lines.append(
        "For each effect, answers were aligned and ranked (aligned rank transform, ART; Wobbrock et al., 2011) "
        "and tested by "
        + (
            "linear mixed models with a random intercept for each participant (REML; Kenward & Roger, 1997; type III)."
            if model.kind == "mixed"
            else "repeated-measures analyses of variance, each effect against its own error stratum (type III)."
            if inside
            else "analyses of variance (type III)."
        )
    )
    if analysis.effects[0].p_spread is not None:
        known = len({*analysis.table.values.tolist()})
        lines.append(
            f"Answers take {known} values only; on coarse scales ART finds effects that do not exist (Luepsen, 2017), "
            "so F is also given with ties spread, and an effect counts as significant only if both are."
        )
    if analysis.stray_f > 0:
        lines.append(
            f"The design is not balanced: after alignment, other effects still have F up to {analysis.stray_f:.2f} "
            "(0 in a balanced design); the larger it is, the less exact is the transform."
        )
    return " ".join(lines)


def _scale(scale: Reliability) -> str:
    if scale.alpha is None:
        return f"Its {scale.items} items do not vary enough for a reliability."
    assert scale.low is not None and scale.high is not None
    words = (
        f"Of its {scale.items} items (N = {scale.n} complete rows), Cronbach's alpha is {_share(scale.alpha)}, "
        f"95% CI {_interval(EffectSize(scale.alpha, scale.low, scale.high))}"
    )
    if scale.standardised is not None:
        words += f" (standardised {_share(scale.standardised)})"
    if scale.omega is not None:
        words += f", McDonald's omega {_share(scale.omega)} (one factor, maximum likelihood)"
    if scale.at_bound:
        words += "; the factor explains an item completely, so omega is unreliable"
    if scale.left_out:
        words += f"; {_count(scale.left_out, 'row')} with a gap left out"
    return words + "."


def _tests(analysis: Analysis) -> str:
    sentences = []
    for row in analysis.effects:
        kind = "interaction of " if ":" in row.effect else "effect of "
        name = _and(row.effect.split(":"))
        if math.isnan(row.f):
            sentences.append(f"The {kind}{name} could not be tested: nothing varies.")
            continue
        found = "There was a significant" if row.clear else "There was no significant"
        corrected = f" (Greenhouse-Geisser {_p(row.p_corrected)})" if row.p_corrected is not None else ""
        sentences.append(
            f"{found} {kind}{name}, F({_df(row.df1)}, {_df(row.df2)}) = {row.f:.2f}, {_p(row.p)}{corrected}, "
            f"partial eta squared = {_share(row.eta_squared.value)}, 95% CI {_interval(row.eta_squared)}{_spread(row)}."
        )
        own = [c for c in analysis.contrasts if c.effect == row.effect]
        if row.clear and len(own) > 1:
            sentences.append(_differences(own))
    return " ".join(sentences)


def _spread(row: EffectRow) -> str:
    """Return the words on the effect with ties spread; "" if it was not tested so."""
    if row.p_spread is None or row.f_spread is None or math.isnan(row.f_spread):
        return ""
    said = f"; with ties spread, F = {row.f_spread:.2f}, {_p(row.p_spread)}"
    coarse = row.p < ALPHA and not row.clear
    return said + (", so the effect may be an artefact of the coarse scale" if coarse else "")


def _differences(own: Sequence[Contrast]) -> str:
    clear = [c for c in own if c.p_holm < ALPHA]
    said = "; ".join(f"{c.first} - {c.second}: t({_df(c.df)}) = {c.t:.2f}, {_p(c.p_holm)}" for c in clear)
    if not clear:
        return f"None of its {len(own)} pairs differ (ART-C, Elkin et al., 2021; Holm)."
    rest = len(own) - len(clear)
    others = f"; the other {rest} do not" if rest > 1 else "; the other one does not" if rest else ""
    return f"Pairs that differ (ART-C, Elkin et al., 2021; Holm): {said}{others}."


def _plain(rows: Sequence[Omnibus], left_out: Sequence[str]) -> str:
    if not rows:
        return "Plain tests need participants with every condition; there are too few."
    said = "; ".join(
        f"{row.effect}: {row.test} chi squared({row.df}, N = {row.n}) = {row.statistic:.2f}, {_p(row.p)}"
        for row in rows
    )
    gone = f", without {', '.join(left_out)}, who lack a condition" if left_out else ""
    return f"The plain tests, by participants' means over the other factors{gone}: {said}."


def _cells(analysis: Analysis) -> str:
    rows = [
        [c.condition, str(c.n), f"{c.mean:.2f}", _two(c.sd), f"{c.median:.2f}", f"{c.q1:.2f} to {c.q3:.2f}"]
        for c in analysis.cells
    ]
    return _table(["condition", "n", "mean", "SD", "median", "middle half"], rows)


def _effects(rows: Sequence[EffectRow]) -> str:
    made = []
    for r in rows:
        tested = [_four(r.f), _df(r.df1), _df(r.df2), _exact(r.p)]
        sphericity = [_or_blank(r.epsilon, "{:.3f}".format), _or_blank(r.p_corrected, _exact)]
        spread = [_or_blank(r.f_spread, _four), _or_blank(r.p_spread, _exact)]
        size = [_share(r.eta_squared.value), _interval(r.eta_squared)]
        made.append([r.effect, *tested, *sphericity, *size, *spread])
    header = ["effect", "F", "df1", "df2", "p", "epsilon (GG)", "p (GG)", "partial eta squared", "95% CI"]
    return _table([*header, "F (ties spread)", "p (ties spread)"], made)


def _contrasts(rows: Sequence[Contrast]) -> str:
    made = []
    for r in rows:
        tested = [_four(r.estimate), _four(r.se), _df(r.df), _four(r.t), _exact(r.p), _exact(r.p_holm)]
        made.append([r.effect, f"{r.first} - {r.second}", *tested])
    return _table(["effect", "pair", "difference of ranks", "SE", "df", "t", "p", "p (Holm)"], made)


def _plain_table(rows: Sequence[Omnibus]) -> str:
    made = []
    for pair in (pair for row in rows for pair in row.pairs):
        tested = [pair.test, str(pair.n), _exact(pair.p), _exact(pair.p_holm)]
        delta = [f"{pair.delta.value:.2f}", f"[{pair.delta.low:.2f}, {pair.delta.high:.2f}]"]
        effect = _or_blank(pair.rank_biserial, "{:.2f}".format)
        made.append([pair.effect, f"{pair.first} - {pair.second}", *tested, effect, *delta])
    header = ["effect", "pair", "test", "n", "p", "p (Holm)", "rank-biserial r", "Cliff's delta"]
    return _table([*header, "95% CI (bootstrap)"], made)


def _or_blank(value: float | None, text_of: Callable[[float], str]) -> str:
    return "" if value is None else text_of(value)


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(_cell(text) for text in row) + " |" for row in (header, *rows)]
    return "\n".join([lines[0], "|" + " --- |" * len(header), *lines[1:]])


def _cell(text: str) -> str:
    """Return text as a table cell, without line breaks and column separators."""
    return " ".join(text.replace("|", "\\|").replace("<", "&lt;").split())


def _p(p: float | None) -> str:
    if p is None or math.isnan(p):
        return "p unknown"
    return "p < .001" if p < 0.001 else f"p = {p:.3f}".replace("0.", ".", 1)


def _exact(p: float) -> str:
    return "" if math.isnan(p) else f"{p:.4g}"


def _four(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.4f}" if abs(value) < 1000 else f"{value:.4g}"


def _two(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.2f}"


def _df(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.0f}" if abs(value - round(value)) < 0.005 else f"{value:.2f}"


def _share(value: float) -> str:
    """Return a number of at most 1 without its leading zero."""
    if math.isnan(value):
        return "unknown"
    text = f"{value:.2f}"
    return text.replace("0.", ".", 1) if abs(value) < 0.995 else text


def _interval(size: EffectSize) -> str:
    return "unknown" if math.isnan(size.low) else f"[{_share(size.low)}, {_share(size.high)}]"


def _count(number: int, what: str) -> str:
    return f"{number} {what}" + ("" if number == 1 else "s")


def _and(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
