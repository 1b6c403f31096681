"""How an estimator does on views that are spoilt one way at a time, and all ways at once: ``omad eval robustness``."""
