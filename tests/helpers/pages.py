"""Code in the pages of the documentation."""

import re
from pathlib import Path


def blocks(page: Path, language: str) -> list[str]:
    """Fenced code of one language, in order; "" is code without one: commands."""
    return [code for named, code in every_block(page) if named == language]


def every_block(page: Path) -> list[tuple[str, str]]:
    """(language, code) of all fenced blocks, in order."""
    return re.findall(r"^```(\w*)\n(.*?)^```", page.read_text(), re.S | re.M)
