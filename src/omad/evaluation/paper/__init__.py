"""The paper's experiments. Predictions are kept apart from metrics: a table is made anew from them in seconds."""
