"""The command `python -m hsed_jax.run STUDY.yaml`, which is `hsed run STUDY.yaml`.

This file is a command and no module: an import would put the module in the place of the function `hsed_jax.run`.  Python drops
a module that fails to import, so the function stays.
"""

import sys

from hsed_jax.command_line import run_main

if __name__ == "hsed_jax.run":
    raise ImportError(
        "hsed_jax.run is a function, not a module: write `import hsed_jax as hx` and call `hx.run(study)`; in a terminal, "
        "`python -m hsed_jax.run STUDY.yaml` runs a study"
    )
if __name__ == "__main__":
    sys.exit(run_main())
