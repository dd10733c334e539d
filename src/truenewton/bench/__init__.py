"""Tower A: benches that take data."""
