"""The loading protocols as text, the output of `hsed protocols`."""

from typing import Any

from hsed_jax.physics.protocols import PROTOCOLS, TRAILING, protocol


def add_command(commands: Any) -> None:
    """Add `protocols` to the command line."""
    text = "the loading protocols that a planned component test may name"
    protocols = commands.add_parser("protocols", help=text, description=text.capitalize() + ".")
    protocols.add_argument("name", nargs="?", metavar="NAME", help="show one protocol: steps, reference, source")
    protocols.set_defaults(command=_protocols)


def listing() -> str:
    """The names, titles and lengths of the protocols."""
    width = max(len(name) for name in PROTOCOLS)
    lines = [
        f"{name:{width}}  {known.title}: {known.extent()} times the reference" for name, known in PROTOCOLS.items()
    ]
    return "\n".join([*lines, "", "`hsed protocols NAME` shows steps, reference and source."])


def entry(name: str) -> str:
    """One protocol: title, source, the reference of its amplitudes, its steps, and its continuation.

    Raises:
        UserError: there is no protocol of this name.
    """
    known = protocol(name)
    rows = [("step", "amplitude", "cycles", f"trailing cycles at {TRAILING:g} of it")]
    rows += [(str(i), f"{s.amplitude:g}", f"{s.cycles:g}", str(s.trailing)) for i, s in enumerate(known.table, 1)]
    shown = 4 if any(step.trailing for step in known.table) else 3
    beyond = "The protocol ends with this table."
    if known.increment is not None:
        beyond = (
            f"Further steps (`steps` in a study): the last one again, its amplitude larger by {known.increment:g} each."
        )
    return "\n".join(
        [
            f"{name}: {known.title}",
            f"Source: {known.source}.",
            f"Amplitudes are relative to the {known.relative_to}.",
            "",
            *("  ".join(f"{cell:>9}" for cell in row[:shown]) for row in rows),
            "",
            *([known.note] if known.note else []),
            beyond,
            "",
            "In a study:",
            "",
            "excitation:",
            f"  imposed: {{protocol: {name}, reference: a, rate: v}}      # each a number [m, m/s] or the name of an input",
        ]
    )


def _protocols(options: Any) -> int:
    print(entry(options.name) if options.name else listing())
    return 0
