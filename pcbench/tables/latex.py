"""Tables in LaTeX, with booktabs and siunitx, or with neither."""

import re

from pcbench.tables.layout import Entry, Head, Table

NEEDS = r"% needs \usepackage{booktabs, siunitx}"
SPECIAL = {c: rf"\{c}" for c in "{}_%&#$"}
SPECIAL |= {"\\": r"\textbackslash{}", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}"}
LETTERS = {"±": r"$\pm$", "²": r"\textsuperscript{2}", "<": r"\textless{}", ">": r"\textgreater{}"}
IN_UNITS = {"*": " ", "·": r"\cdot ", "²": "^{2}", "³": "^{3}", "°": r"{}^{\circ}", "Ω": r"\Omega "}
IN_UNITS |= dict.fromkeys("µμ", r"\mu ")  # the micro sign, and the letter
OF_UNIT = re.compile(r"\^(-?\d+|\([^()]*\))|(.)", re.S)
SYMBOLS = {"degC": (r"\degreeCelsius", r"^\circ\mathrm{C}"), "%": (r"\percent", r"\%")}  # with siunitx, and without
ESTIMATE = re.compile(r"\(?(?P<value>[-+\d.e]+?)(?: ± (?P<half>[\d.]+|\?)\)?)?(?:e(?P<power>[-+]\d+))?")
LEANING = re.compile(r"(?P<value>\S+) \((?P<low>\S+) \.\. (?P<high>\S+)\)")
NUMBER = re.compile(r"([-+]?[\d.]+)(?:e([-+]?\d+))?")


def latex(tables: list[Table], plain: bool = False) -> str:
    """Return tables as LaTeX; `plain` with no package but LaTeX's own."""
    return "\n".join([*([] if plain else [NEEDS, ""]), *(_table(t, plain) for t in tables)])


def _table(t: Table, plain: bool) -> str:
    top, middle, bottom = (r"\hline",) * 3 if plain else (r"\toprule", r"\midrule", r"\bottomrule")
    heads = " & ".join(_head(h, plain) for h in [*t.stub, *t.heads])
    label = re.sub(r"[^\w-]+", "-", "-".join(filter(None, (t.scenario, t.signal))))
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{_text('. '.join([t.about, ' '.join(t.notes)]))}}}",
        rf"\label{{tab:{label}}}",
        *([] if plain else [r"\sisetup{separate-uncertainty = true, detect-all, group-digits = integer}"]),
        rf"\begin{{tabular}}{{{'l' * len(t.stub)}{'r' * len(t.heads)}}}",
        top,
        *_over(t, plain),
        rf"{heads} \\",
        middle,
        *(rf"{' & '.join([*map(_text, words), *(_entry(e, plain) for e in each)])} \\" for words, each in t.rows),
        bottom,
        r"\end{tabular}",
        r"\end{table}",
        "",
    ]
    return "\n".join(lines)


def _over(t: Table, plain: bool) -> list[str]:
    """The line above the heads that says whose values they are."""
    if not t.over:
        return []
    first, many = len(t.stub) + 1, len(t.heads)
    rule = rf"{first}-{first + many - 1}"
    line = rf"{'& ' * len(t.stub)}\multicolumn{{{many}}}{{c}}{{{_head(t.over, plain)}}} \\"
    return [line, rf"\cline{{{rule}}}" if plain else rf"\cmidrule(lr){{{rule}}}"]


def _head(h: Head, plain: bool) -> str:
    if not h.unit or h.unit == "1":
        return _text(h.text)
    with_siunitx, without = SYMBOLS.get(h.unit) or (_power(h.unit), rf"\mathrm{{{_power(h.unit)}}}")
    unit = f"${without}$" if plain else rf"\unit{{{with_siunitx}}}"
    return f"{_text(h.text)} [{unit}]"


def _power(unit: str) -> str:
    """A unit with its exponents in braces, more than one digit being one exponent, and all specials of LaTeX escaped."""
    return OF_UNIT.sub(
        lambda m: f"^{{{_power(m[1])}}}" if m[1] else IN_UNITS.get(m[2]) or SPECIAL.get(m[2], m[2]), unit
    )


def _text(words: str) -> str:
    return "".join((SPECIAL | LETTERS).get(c, c) for c in words)


def _entry(entry: Entry | None, plain: bool) -> str:
    if entry is None:
        return "--"
    text = _estimate(entry.text, plain)
    if entry.best:
        text = rf"{{\boldmath\bfseries {text}}}"
    return text + (r"\textsuperscript{\dag}" if entry.lost else "")


def _estimate(text: str, plain: bool) -> str:
    """An estimate as `number_format` writes it, in LaTeX."""
    if leaning := LEANING.fullmatch(text):
        value, low, high = (_number(leaning[k], plain) for k in ("value", "low", "high"))
        return f"{value} ({low} to {high})"
    found = ESTIMATE.fullmatch(text)
    if not found:
        return "--"
    half, power = found["half"], found["power"]
    if half in (None, "?"):
        return _number(text.removesuffix(" ± ?"), plain)
    if plain:
        both = rf"{found['value']} \pm {half}"
        return f"$({both}) \\times 10^{{{int(power)}}}$" if power else f"${both}$"
    return rf"\num{{{found['value']} \pm {half}{f' e{int(power)}' if power else ''}}}"


def _number(text: str, plain: bool) -> str:
    if not (found := NUMBER.fullmatch(text)):
        return "--"
    if not plain:
        return rf"\num{{{text}}}"
    if not found[2]:
        return f"${text}$"
    return rf"${found[1]} \times 10^{{{int(found[2])}}}$"
