"""OMADNet's forward pass on the CPU without autograd: compiled loops between plain matrix products."""
