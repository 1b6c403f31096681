"""How good it is: metrics, baselines, the paper's tables and figures, the demo."""
