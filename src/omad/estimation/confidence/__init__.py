"""How far to believe an estimate: signals that the estimation has anyway, and a model that was fitted to them."""
