"""Fits what tells how far to believe an estimate, and measures whether it keeps its word: ``omad train confidence``."""
