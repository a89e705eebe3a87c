"""Entry point of `python -m palpate.cli`, where the command is not on the path."""

from palpate.cli import main

if __name__ == "__main__":
    main()
