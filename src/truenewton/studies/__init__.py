"""Above both towers: what must see the truth and the estimate."""
