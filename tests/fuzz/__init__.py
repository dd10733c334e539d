"""Fuzz: damaged files and absurd options for every command."""
