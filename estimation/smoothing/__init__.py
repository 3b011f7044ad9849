"""Fixed-interval estimates: what all of a recording says of each step."""
