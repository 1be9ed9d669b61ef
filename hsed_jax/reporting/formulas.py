"""Formulas as text: LaTeX of descriptions and forms, readable in a terminal."""

import re

_LETTERS = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "Delta": "Δ", "epsilon": "ε", "zeta": "ζ", "eta": "η", "kappa": "κ",
    "lambda": "λ", "mu": "μ", "nu": "ν", "pi": "π", "rho": "ρ", "sigma": "σ", "tau": "τ", "phi": "φ", "psi": "ψ", "omega": "ω",
    "ell": "ℓ",
}  # fmt: skip
_SIGNS = {
    "propto": "∝", "to": "→", "int": "∫", "sum": "Σ", "infty": "∞", "cdot": "·", "le": "≤", "ge": "≥", "pm": "±", "ldots": "…",
}  # fmt: skip
_POWERS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
# A group in braces, with groups in it.
_GROUP = r"\{((?:[^{}]|\{(?:[^{}]|\{[^{}]*\})*\})*)\}"


def in_text(latex: str) -> str:
    r"""A formula, or a sentence with some, without LaTeX: `e^{\delta x}` is e^(δx)."""
    text = re.sub(r"\\(?:mathrm|text)\{([^{}]*)\}", r" \1 ", latex)
    text = re.sub(r"\\(?:[Bb]ig|left|right)(?![a-z])", "", text)
    text = re.sub(r"\\(?:[,;:! ]|q?quad)", " ", text)
    text = re.sub(rf"\\({'|'.join(_LETTERS)})(?![A-Za-z])(?: (?=[A-Za-z]))?", lambda m: _LETTERS[m[1]], text)
    text = re.sub(r"\\dot\{? *(\w)\}?", "\\1\u0307", text.replace("$", ""))
    text = re.sub(r"\\frac" + _GROUP + _GROUP, lambda m: f"({_term(m[1])}/{_factor(m[2])}) ", text)
    text = re.sub(r"\\sqrt" + _GROUP, r"√(\1) ", text)
    text = re.sub(r"\\([A-Za-z]+) *", lambda m: f" {_SIGNS.get(m[1], m[1])} ", text)
    text = re.sub(r"\^(\d+)", lambda m: m[1].translate(_POWERS), text)
    text = re.sub(r"\^" + _GROUP, lambda m: f"^{_factor(m[1])}", text)
    text = re.sub(r"[{}]", "", re.sub(r"(?<=\S) {2,}", " ", text))
    text = re.sub(r"\b(max|min|exp|ln|tanh|sign|logistic) (?=[(|])", r"\1", text)
    text = re.sub(r"\(\(([^()]*)\) ?\)", r"(\1)", re.sub(r"(?<=[([]) | (?=[)\],;.])", "", text))
    return "\n".join(line.rstrip() for line in text.splitlines())


def _term(group: str) -> str:
    """A dividend: in parentheses if it is a sum."""
    inner = re.sub(r"\([^()]*\)", "", group)
    return f"({group.strip()})" if re.search(r"[-+−]", inner) else group.strip()


def _factor(group: str) -> str:
    """A divisor or exponent: in parentheses unless it is one number or name."""
    return group if re.fullmatch(r"\d+|\w(_\w+)?", group.strip()) else f"({group.strip()})"
