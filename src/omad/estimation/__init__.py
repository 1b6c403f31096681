"""From an observation to an ``Estimate``, and whether to believe it: evidence, other categories, what to check."""
