"""Helpers that the tests share: mirrors, campaigns, files and benches."""
