"""The figures of the paper, drawn from weights: each module measures one thing and draws it."""
