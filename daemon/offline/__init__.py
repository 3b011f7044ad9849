"""Commands that work on recordings and seeds, not on devices."""
