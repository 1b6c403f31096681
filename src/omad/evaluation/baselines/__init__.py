"""What the paper compares with: A-NCSH, the Siamese network, Adam."""
