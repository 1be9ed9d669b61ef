"""Writes the README's Python as `example.py`, with the study of `configs/hidden_effect.yaml` in two parts beside it: a virtual
specimen to be measured (`measure.yaml`), and the model of the campaign `my_campaign` (`study.yaml`).

`readme.py README.md configs/hidden_effect.yaml FOLDER`
"""

import re
import sys
from pathlib import Path


def main(readme: str, config: str, folder: str) -> int:
    """Write them; returns the exit status."""
    (code,) = re.findall(r"## In Python\n.*?```python\n(.*?)```", Path(readme).read_text(encoding="utf-8"), re.DOTALL)
    study, here = Path(config).read_text(encoding="utf-8"), Path(folder)
    check = 'print(diagnosis)\nassert diagnosis.effects == ["stiffness_degradation"], diagnosis\n'
    (here / "example.py").write_text(code + check, encoding="utf-8")
    (here / "measure.yaml").write_text(study, encoding="utf-8")
    # A campaign that was measured takes the place of the virtual specimen.
    model, count = re.subn(r"^experiments:\n( .*\n)+", "experiments: {campaign: .}\n", study, flags=re.MULTILINE)
    assert count == 1
    (here / "study.yaml").write_text(model, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
