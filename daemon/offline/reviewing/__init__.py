"""What a recording holds and shows."""
