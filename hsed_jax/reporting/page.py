"""A page that needs no other file: a template with its styles, its script, its data and the drawing library."""

import json
import os
from base64 import b64encode
from contextlib import suppress
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from hsed_jax.backend import cache_folder
from hsed_jax.drafts import write_whole
from hsed_jax.reporting.page_tables import unit_words
from hsed_jax.tables import odds

GENERATOR = '<meta name="generator" content="hsed_jax">'
"""The mark of a page of this package."""


def number(value: float | None) -> str:
    """Four digits; a dash without a number."""
    return f"{value:.4g}" if value is not None and np.isfinite(value) else "–"


def render(template: str, **content: Any) -> str:
    """Fill a template of `templates/`; `data` is for its script."""
    here = Path(__file__).parent / "templates"
    files = {name: (here / f"page.{name}").read_text(encoding="utf-8") for name in ("css", "js")}
    library = _library()
    about = {"generator": GENERATOR, "files": files, "library": library, "policy": _policy(library, files["js"])}
    return _environment().get_template(template).render(**about, **content)


@cache
def _environment() -> Environment:
    """What compiles the templates, once in a process."""
    environment = Environment(
        loader=PackageLoader("hsed_jax.reporting", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": number, "odds": odds, "embedded": _embedded, "unit": unit_words}
    return environment


def _policy(*scripts: str) -> str:
    """The Content-Security-Policy of a page: only these scripts run, and nothing is fetched, for any other content of the page.

    Vega compiles the expressions of its charts, which the policy calls `unsafe-eval`.
    """
    hashes = (b64encode(sha256(script.encode()).digest()).decode() for script in scripts)
    allowed = " ".join(f"'sha256-{one}'" for one in hashes)
    return (
        f"default-src 'none'; script-src {allowed} 'unsafe-eval'; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def _embedded(content: Any) -> str:
    """JSON that can stand in a script element."""
    return json.dumps(content, ensure_ascii=False, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


@cache
def _library() -> str:
    """Vega, Vega-Lite and vega-embed as one script; nothing in it ends the script element.

    It takes a second to make, and is kept for the next page where a file can be written.
    """
    folder = cache_folder()
    kept = None if folder is None else folder / f"vega-{version('altair')}-{version('vl-convert-python')}.js"
    with suppress(OSError):
        if kept is not None:
            return kept.read_text(encoding="utf-8")
    from altair import SCHEMA_VERSION
    from vl_convert import javascript_bundle

    spoken = SCHEMA_VERSION.rpartition(".")[0]  # "v6.4": the version of the language of the charts
    script = javascript_bundle("window.vegaEmbed = vegaEmbed;", spoken).replace("</script", "<\\/script")
    with suppress(OSError):
        if kept is not None:
            write_whole(kept, script, draft=f".{os.getpid()}")
    return script
