"""`python -m hsed_jax.run STUDY.yaml`: the command `hsed run`.

Nothing imports this module: `hsed_jax.run` is the function.
"""

import sys

from hsed_jax.command_line import run_main

if __name__ == "__main__":
    sys.exit(run_main())
