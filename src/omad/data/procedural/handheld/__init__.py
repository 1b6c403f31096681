"""Random things to hold in a hand or to have on a desk."""
