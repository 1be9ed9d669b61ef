"""Makes a script of the README's Python, which also checks what it prints.

`readme.py README.md FOLDER` writes `example.py` and the study that it reads into the folder.
"""

import re
import shutil
import sys
from pathlib import Path

# Runs the example and compares what it prints with what the README shows: the words, and the numbers to a twentieth.
CHECK = """
import io, math, re, contextlib

def words_and_numbers(text):
    number = r"(?<![\\w.])[-+]?\\d+\\.?\\d*(?:e[-+]?\\d+)?"
    return re.sub(number, "#", re.sub(r"[ ]+", " ", text)).split(), [float(one) for one in re.findall(number, text)]

printed = io.StringIO()
with contextlib.redirect_stdout(printed):
    exec(EXAMPLE)
print(printed.getvalue())
(words, numbers), (known_words, known) = words_and_numbers(printed.getvalue()), words_and_numbers(SHOWN)
assert words == known_words, (words, known_words)
assert all(math.isclose(a, b, rel_tol=0.05, abs_tol=0.002) for a, b in zip(numbers, known, strict=True)), (numbers, known)
"""


def main(readme: str, folder: str) -> int:
    """Write them; returns the exit status."""
    text, root, here = Path(readme).read_text(encoding="utf-8"), Path(readme).resolve().parent, Path(folder)
    section = text.split("## In Python\n")[1].split("\n## ")[0]
    (code,), (shown,) = (re.findall(rf"```{kind}\n(.*?)```", section, re.DOTALL) for kind in ("python", "text"))
    (here / "example.py").write_text(f"EXAMPLE = {code!r}\nSHOWN = {shown!r}\n{CHECK}", encoding="utf-8")
    for study in re.findall(r'"(configs/\w+\.yaml)"', code):
        (here / study).parent.mkdir(exist_ok=True)
        shutil.copy(root / study, here / study)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
