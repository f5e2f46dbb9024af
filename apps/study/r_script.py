"""Write the analysis as a script for R, with ARTool, emmeans and psych, as an independent check."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import combinations

from glsplat.extras.study.analysis.analysis import Analysis


def r_script(
    table: str, analyses: Sequence[Analysis], *, participant: str, response: str, long: bool, items: Sequence[str] = ()
) -> str:
    """Return the script. ``table`` is the CSV file; ``long``: a column "measure" has the response.

    ``items``: columns of the table for Cronbach's alpha.
    """
    lines = [
        "# The aligned rank transform by ARTool, as glsplat study analyse does it.",
        '# install.packages(c("ARTool", "emmeans", "lme4", "psych"))',
        "library(ARTool); library(emmeans)",
        f'whole <- read.csv({_text(table)}, check.names = FALSE, colClasses = "character", na.strings = c("", "NA"))',
    ]
    for analysis in analyses:
        lines += ["", *_measure(analysis, participant, response, long)]
    if len(items) > 1:
        names = ", ".join(map(_text, items))
        lines += ["", "# reliability of the scale", f"psych::alpha(sapply(whole[c({names})], as.numeric))"]
    return "\n".join(lines) + "\n"


def _measure(analysis: Analysis, participant: str, response: str, long: bool) -> list[str]:
    table, model = analysis.table, analysis.model
    names = [_symbol(factor.name, i) for i, factor in enumerate(table.factors)]
    lines = ["# " + re.sub(r"[\r\n]+", " ", table.response)]
    lines.append(f'd <- whole[whole[["measure"]] == {_text(table.response)}, ]' if long else "d <- whole")
    lines += [
        f"d$answer <- as.numeric(d[[{_text(response)}]])",
        "d <- d[!is.na(d$answer), ]",
        f"d$person <- factor(d[[{_text(participant)}]])",
    ]
    for symbol, factor in zip(names, table.factors, strict=True):
        lines.append(
            f"d${symbol} <- factor(d[[{_text(factor.name)}]], levels = c({', '.join(map(_text, factor.levels))}))"
        )
    if model.left_out:
        lines.append(f"d <- droplevels(d[!d$person %in% c({', '.join(map(_text, model.left_out))}), ])  # incomplete")
    inside = [names[i] for i in table.within]
    if model.kind == "rm" and inside and not model.table.balanced:
        lines.append("# groups differ in size: ARTool's tests of aov are type I, ours type III (car's Anova)")
    if len(names) > 3:
        lines.append(
            "# look at summary(m): with 4 factors, ARTool also aligns interactions of three for those of the fourth"
        )
    lines += [
        f"m <- art(answer ~ {' * '.join(names)}{_error(model.kind, inside)}, data = d)",
        "print(anova(m))",
    ]
    for size in (1, 2):
        for chosen in combinations(range(len(names)), size):
            lines += _contrasts(names, chosen, inside, model.kind)
    return lines


def _contrasts(names: list[str], chosen: tuple[int, ...], inside: list[str], kind: str) -> list[str]:
    """Return the ART-C contrasts of an effect, with its factors joined into one, also in the error strata."""
    own = [names[i] for i in chosen]
    if len(own) == 1:
        return [f'print(art.con(m, "{own[0]}", adjust = "holm"))']
    joint = "both"
    others = [name for name in names if name not in own]
    strata = [name for name in inside if name not in own]
    if set(own) <= set(inside):
        strata = [joint, *strata]
    elif set(own) & set(inside):
        kind = "mixed"  # emmeans of aov is biased across strata; lmer equals our contrasts in balanced designs
    error = _error(kind, strata, person=bool(inside))
    return [
        f'd${joint} <- interaction({", ".join(f"d${name}" for name in own)}, sep = ",", lex.order = TRUE)',
        f'print(art.con(art(answer ~ {" * ".join([joint, *others])}{error}, data = d), "{joint}", adjust = "holm"))',
    ]


def _error(kind: str, strata: list[str], person: bool = False) -> str:
    if kind == "mixed":
        return " + (1 | person)"
    if strata:
        return f" + Error(person / ({' * '.join(strata)}))"
    return " + Error(person)" if person else ""


def _symbol(name: str, place: int) -> str:
    """Return a factor's name as a symbol of R; ``factorN`` if it is invalid or taken."""
    plain = re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name)
    taken = {"answer", "person", "both", "measure", "d", "m", "whole", "if", "else", "for", "in", "next", "break"}
    taken |= {"repeat", "while", "function", "TRUE", "FALSE", "NULL", "NA", "NaN", "Inf", "T", "F"}
    return name if plain and name not in taken else f"factor{place + 1}"


def _text(text: str) -> str:
    """Return text as a string literal of R."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n").replace("\r", "\\r")
    return f'"{escaped}"'
