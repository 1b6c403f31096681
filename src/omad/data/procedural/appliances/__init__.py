"""Random appliances of kitchens and laundries."""
