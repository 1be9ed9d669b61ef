"""Runs the README's Python in an empty folder and compares what it prints with what the README shows.

`readme.py README.md FOLDER`, with the Python of the installed package.
"""

import contextlib
import io
import os
import re
import shutil
import sys
from pathlib import Path

from same import difference


def main(readme: str, folder: str) -> int:
    """Run it; returns the exit status."""
    text, root, here = Path(readme).read_text(encoding="utf-8"), Path(readme).resolve().parent, Path(folder)
    section = text.split("## In Python\n")[1].split("\n## ")[0]
    (code,), (shown,) = (re.findall(rf"```{kind}\n(.*?)```", section, re.DOTALL) for kind in ("python", "text"))
    for study in re.findall(r'"(configs/\w+\.yaml)"', code):
        (here / study).parent.mkdir(exist_ok=True)
        shutil.copy(root / study, here / study)
    os.chdir(here)
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(code, {})
    print(printed.getvalue())
    if (found := difference(printed.getvalue(), shown)) is not None:
        print(f"{readme}: {found}")
    return int(found is not None)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
