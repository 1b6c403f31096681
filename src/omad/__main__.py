"""``python -m omad``."""

from .cli import main

main()
