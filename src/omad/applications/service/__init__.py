"""Estimates over HTTP: requests that come together are answered together, within bounds that no request exceeds."""
