"""``python -m evqr``: the command line, where its script is not on the path."""

from evqr.main import main

if __name__ == "__main__":
    main()
