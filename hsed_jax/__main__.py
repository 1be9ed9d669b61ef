"""The `hsed` command, also `python -m hsed_jax`: a Ctrl-C is handled from here on, before anything else is loaded."""

import sys


def main() -> int:
    """Load the command line and execute it."""
    try:
        from hsed_jax.command_line import main as command

        return command()
    except KeyboardInterrupt:
        # The words and the status of `exit_status`, which may not be loaded yet.
        print("stopped before there was anything to keep", file=sys.stderr)
        return 3


if __name__ == "__main__":
    sys.exit(main())
