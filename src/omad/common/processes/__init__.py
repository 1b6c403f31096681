"""What processes need of each other: locks, signals, helpers."""
