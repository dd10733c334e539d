"""Running a plan on any bench, so that nothing is lost and nothing goes beyond its limit."""
