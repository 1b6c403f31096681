"""Which categories a cloud may be of, from one quick look."""
