"""Where object models come from."""
