"""``omad eval``: how good weights are, one command a file."""
