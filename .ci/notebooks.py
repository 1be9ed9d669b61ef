"""Executes the notebooks and compares what comes out with what they show; `--write` keeps what comes out.

`python3 -m uv run --group notebooks python .ci/notebooks.py [--write | --tell] [NAME ...]`, such as `03_hidden_effect`.

A notebook `notebooks/NAME.ipynb` has a text form `notebooks/text/NAME.py`, which is the one to edit.  Words of an output must be
equal and numbers nearly; of a picture only that it is there.  With `--tell` a difference is told and no fault: draws under a time
limit depend on the machine, and CI has another one; a cell that raises is one always.  Progress bars and warnings (stderr) are
not kept.
"""

import argparse
import base64
import io
import re
import sys
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient
from PIL import Image
from same import difference

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
# What differs from run to run: folders of the moment, dates, object addresses.
_CHANGING = re.compile(r"/tmp/\S+|0x[0-9a-f]+|\d{4}-\d\d-\d\dT[\d:.+]+|\d+(?:\.\d+)? ?(?:ms|µs|s)\b")


def executed(name: str) -> nbformat.NotebookNode:
    """The notebook of a text form, run from its first cell to its last."""
    notebook = jupytext.read(FOLDER / "text" / f"{name}.py")
    notebook.metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    NotebookClient(notebook, timeout=1800, resources={"metadata": {"path": str(FOLDER)}}).execute()
    for number, cell in enumerate(notebook.cells):
        cell.id = f"cell-{number}"
        cell.metadata = {}
        if cell.cell_type == "code":
            cell.outputs = [_small(output) for output in cell.outputs if output.get("name") != "stderr"]
    return notebook


def _small(output: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """An output with one form beside its text: a picture or HTML."""
    if "data" in output:
        kinds = [kind for kind in ("image/png", "text/html") if kind in output.data][:1]
        output.data = {kind: output.data[kind] for kind in (*kinds, "text/plain")}
        if "image/png" in output.data:
            output.data["image/png"] = _in_few_colours(output.data["image/png"])
        output.metadata = {}
    return output


def _in_few_colours(picture: str) -> str:
    """A figure with a palette: a third of the bytes."""
    made = io.BytesIO()
    Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB").quantize(64).save(made, "png", optimize=True)
    return base64.b64encode(made.getvalue()).decode()


def text_of(output: nbformat.NotebookNode) -> str:
    """What an output says: a picture is one word."""
    data = output.get("data", {})
    said = "picture" if "image/png" in data else data.get("text/plain", output.get("text", ""))
    return _CHANGING.sub("…", said)


def faults(ours: nbformat.NotebookNode, kept: nbformat.NotebookNode) -> list[str]:
    """How an executed notebook differs from the kept one."""
    if [(c.cell_type, c.source) for c in ours.cells] != [(c.cell_type, c.source) for c in kept.cells]:
        return ["its text form has other cells"]
    found = []
    for number, (cell, shown) in enumerate(zip(ours.cells, kept.cells, strict=True)):
        texts = ["\n".join(text_of(output) for output in one.get("outputs", [])) for one in (cell, shown)]
        if (said := difference(*texts)) is not None:
            found.append(f"cell {number}: {said}")
    return found


def main() -> int:
    """The command; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="notebooks (default: all)")
    kept = parser.add_mutually_exclusive_group()
    kept.add_argument("--write", action="store_true", help="keep what comes out")
    kept.add_argument("--tell", action="store_true", help="tell differences, which are no faults")
    options = parser.parse_args()
    names = options.names or sorted(path.stem for path in (FOLDER / "text").glob("*.py"))
    wrong = 0
    for name in names:
        file, notebook = FOLDER / f"{name}.ipynb", executed(name)
        if options.write:
            nbformat.write(notebook, file)
            print(f"{name}: {file.stat().st_size / 1024:.0f} KiB", flush=True)
            continue
        found = faults(notebook, nbformat.read(file, as_version=4))
        wrong += bool(found)
        print("\n".join([f"{name}: {'as it is shown' if not found else 'it differs'}", *found]), flush=True)
    return int(wrong > 0 and not options.tell)


if __name__ == "__main__":
    sys.exit(main())
