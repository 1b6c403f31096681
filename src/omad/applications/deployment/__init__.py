"""Estimators as programs of their own, for machines without PyTorch."""
