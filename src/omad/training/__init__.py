"""The training loop, the losses, and what is trained with them."""
