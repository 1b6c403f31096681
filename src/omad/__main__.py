"""``python -m omad``, and the command ``omad``."""

from omad.common.processes.signals import end_at_once


def main() -> None:
    """What the command does; until all is imported, Ctrl-C ends it with one line."""
    end_at_once()
    from omad.cli.main import main

    main()


if __name__ == "__main__":
    main()
