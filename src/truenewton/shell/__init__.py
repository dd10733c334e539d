"""Tower A: the elastic shell."""
