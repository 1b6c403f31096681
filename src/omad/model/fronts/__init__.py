"""What tells categories apart that are alike but for their fronts."""
