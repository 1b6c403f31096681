"""``python -m omad``."""

from omad.cli.main import main

main()
