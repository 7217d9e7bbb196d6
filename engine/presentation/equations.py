"""Equations as people type them, in LaTeX: names of several letters upright, powers, Greek letters."""

from __future__ import annotations

import re

GREEK = (
    "alpha", "beta", "gamma", "delta", "epsilon", "theta", "lambda", "mu", "nu", "pi", "rho", "sigma", "tau",
    "phi", "psi", "omega", "Gamma", "Delta", "Theta", "Lambda", "Sigma", "Phi", "Psi", "Omega",
)  # fmt: skip
FUNCTIONS = ["sin", "cos", "tan", "exp", "log", "max", "min"]
OTHERS = ["sign", "clip", "arctan", "diag", "sqrt"]
_WORD = re.compile(r"[A-Za-z][A-Za-z0-9]*(?:_[A-Za-z0-9]+)*")


def to_latex(equation: str) -> str:
    r"""``v' = dt * c * sign(v)`` as ``v' = \Delta t\, c\, \operatorname{sign}(v)``."""
    text = equation.replace("->", r" \to ").replace("<=", r" \le ").replace(">=", r" \ge ")
    text = re.sub(r"(?<!\\)\.\.\.", r"\\dots", text)
    text = re.sub(r"\^\(([^()]*)\)", r"^{\1}", text)
    text = re.sub(r"\^(-?\d+(?:\.\d+)?)", r"^{\1}", text)
    out, last = [], 0
    for match in _WORD.finditer(text):
        out.append(text[last : match.start()])
        escaped = match.start() > 0 and text[match.start() - 1] == "\\"
        out.append(match.group() if escaped else _name(match.group()))
        last = match.end()
    text = "".join([*out, text[last:]]).replace(" * ", r"\, ").replace("*", r"\, ")
    text = text.replace("~", r"\sim ").replace("%", r"\%")
    return re.sub(r" {2,}", " ", text).strip()


def _name(word: str) -> str:
    if word == "dt":
        return r"\Delta t"
    if word in FUNCTIONS:
        return f"\\{word}"
    if word in OTHERS:
        return f"\\operatorname{{{word}}}"
    head, _, index = word.partition("_")
    letter, number = head[0], head[1:]
    if number.isdigit() and not index:
        return f"{letter}_{{{number}}}"
    if head not in GREEK and number:
        return _upright(word)
    symbol = f"\\{head}" if head in GREEK else head
    if not index:
        return symbol
    inner = index if len(index) == 1 or index.isdigit() else _upright(index)
    return f"{symbol}_{{{inner}}}"


def _upright(word: str) -> str:
    return r"\mathrm{" + word.replace("_", r"\_") + "}"
