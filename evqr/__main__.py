"""The program `evqr`, also as ``python -m evqr``."""

import sys


def main() -> None:
    """Run the command line and exit with its status; Ctrl-C while it is being loaded is one line, too."""
    try:
        from evqr.main import main as run_and_exit

        run_and_exit()
    except KeyboardInterrupt:
        sys.stderr.write("evqr: interrupted\n")
        sys.exit(130)


if __name__ == "__main__":
    main()
