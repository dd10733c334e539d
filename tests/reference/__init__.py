"""Recorded reference results: what guards every restructuring (`make reference`)."""
