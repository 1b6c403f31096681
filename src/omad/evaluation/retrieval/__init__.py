"""The paper's Table 3: galleries drawn from a pool of described views, and their scores."""
