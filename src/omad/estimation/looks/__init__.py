"""Looking at clouds: which of their points, in which frames, in a mirror or not, and what is said of them."""
