"""Names of channels in the languages that laboratories write: English, German, Italian, French, Spanish, Portuguese, Japanese."""

import re
import unicodedata

STRONG, WEAK, INDEXED = 4, 3, 2
"""Scores of a name: a word, a symbol of one or two letters, a symbol with a number."""

_ELONGATION = """
displacement displ disp deplacement depl desplazamiento desplaz deslocamento spostamento spost weg verschiebung verformung
verlangerung auslenkung durchbiegung elongation allongement allungamento alargamiento alongamento extension extensometer stroke
crosshead deflection defl deformation deformazione deformacion deformacao drift slip lvdt rotation rot rotazione rotacion rotacao
drehung verdrehung strain dehnung kolbenweg traversenweg standardweg maschinenweg hub position pos corsa course recorrido carrera
fleche freccia flecha deriva wegaufnehmer 変位 伸び ひずみ 位移 変形
"""
_FORCE = """
force load kraft last fuerza forca forza carga carico charge effort esfuerzo esforco shear taglio cortante querkraft kolbenkraft
prufkraft standardkraft maschinenkraft loadcell kraftmessdose moment momento biegemoment stress spannung contrainte torque
horizontalkraft horizontallast 荷重 力 载荷 応力
"""
_TIME = """
time zeit temps tempo tiempo timestamp elapsed seconds sekunden secondes segundos secondi laufzeit prufzeit messzeit
datum date 時間 时间
"""
_GROUND = "ground table base bodenbeschleunigung tisch"
# Words of a motion or of a control, not of the response: a name with one of these is not an elongation, force or time of a test.
_NEVER = """
command cmd soll sollwert sollweg sollkraft setpoint target demand desired consigne consigna riferimento rate velocity
velocita vitesse velocidad velocidade speed geschwindigkeit temperature temperatur temperatura count counter cycle
cycles zyklus cycle_number segment index step status error voltage spannung_v power energy energie energia arbeit work
max maximum min minimum mean avg average std frequency frequenz preload
"""
_TRANSVERSE = "vertical axial normal vertikal axiale verticale outofplane oop prestress vorspannung"
_SYMBOLS = {
    "elongation": r"u|d|x|w|du|dx|ds|delta|theta|phi|gamma|eps|epsilon|δ|ε|θ|γ",
    "force": r"f|p|q|v|m|r|fx|fy|fz|sigma|tau|σ|τ",
    "time": r"t",
    "ground_acceleration": r"ag|a_g|xg|ug",
}
_STRONG = {
    "elongation": frozenset(_ELONGATION.split()),
    "force": frozenset(_FORCE.split()),
    "time": frozenset(_TIME.split()),
}
_COMPOUNDS = {
    # German joins words, with the measured quantity at the end; names of loggers are abbreviated.
    "elongation": re.compile(
        r"(weg|verschiebung|verformung|displacement|disp|lvdt|drift|extension|dehnung|rotation|変位|位移)\d*"
    ),
    "force": re.compile(r"(kraft|force|load|loadcell|moment|stress|荷重)\d*"),
    "time": re.compile(r"(zeit|time|時間)\d*"),
}


def strength(channel: str, name: str) -> int:
    """The score of a name, without its unit, as the name of a channel: `STRONG`, `WEAK`, or 0."""
    words = _words(name)
    if channel == "ground_acceleration":
        moves = any(word.startswith(("acc", "beschl")) or word.endswith("beschleunigung") for word in words)
        if (moves and any(word in _GROUND.split() for word in words)) or "bodenbeschleunigung" in words:
            return STRONG
        return WEAK if re.fullmatch(_SYMBOLS[channel], "".join(words)) else 0
    if is_never(name) or (channel == "elongation" and any(word in _GROUND.split() for word in words)):
        return 0
    if any(word in _STRONG[channel] or _ends_in(channel, word) for word in words):
        return STRONG
    bare = "".join(words) or name.strip()
    if re.fullmatch(_SYMBOLS[channel], bare):
        return WEAK
    return INDEXED if re.fullmatch(rf"({_SYMBOLS[channel]})\d+", bare) else 0


def is_never(name: str) -> bool:
    """Whether a name contains a word for a command, a rate, a count or another quantity."""
    words = _words(name)
    return any(
        word in _NEVER.split() or word.startswith(("accel", "beschl", "veloc")) or word == "acc" for word in words
    )


def is_transverse(name: str) -> bool:
    """Whether a name marks a displacement or force as not in the usual direction of loading."""
    return any(word in _TRANSVERSE.split() for word in _words(name))


def is_channel(name: str) -> bool:
    """Whether a name contains a word for one of the channels."""
    return any(strength(channel, name) == STRONG for channel in (*_STRONG, "ground_acceleration"))


def _words(name: str) -> list[str]:
    """The words of a name in small letters without accents: `HorizontalForce_1` is horizontal, force, 1."""
    # Letters lose their accents; kana and kanji stay unchanged.
    plain = "".join(
        c for c in unicodedata.normalize("NFKD", name) if not (unicodedata.combining(c) and ord(c) < 0x3000)
    )
    plain = unicodedata.normalize("NFC", plain)
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", plain)
    return [word for word in re.split(r"[^\w]+|_", parted.casefold()) if word]


def _ends_in(channel: str, word: str) -> bool:
    found = None
    for found in _COMPOUNDS[channel].finditer(word):  # noqa: B007  # the last one counts
        pass
    return found is not None and found.end() == len(word) and (found.start() == 0 or len(word) > 4)
